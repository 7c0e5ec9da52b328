"""A disturbance of your own: the load at the tool changes, and the encoders do not see how the boom bends.

Prints how far the tool really is from where the controller believes it to be, load by load, and draws it.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import longreach

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "own_disturbance.png")

with longreach.lockstep(seed=1) as rig:
    rig.enable()
    misses_mm = {}
    for load_kg in (0.0, 50.0, 100.0):
        rig.plant.set_payload(load_kg)
        reached = rig.run("move", offset_base_m=[0.0, 0.0, 0.01])
        misses_mm[load_kg] = 1e3 * float(np.linalg.norm(rig.truth.X_BT[:3, 3] - reached.X_BT[:3, 3]))

for load_kg, miss_mm in misses_mm.items():
    print(f"{load_kg:5.0f} kg: {miss_mm:5.1f} mm from where the controller believes the tool to be")

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.plot(list(misses_mm), list(misses_mm.values()), "o-")
axes.set(
    xlabel="load, kg",
    ylabel="tool from where it is believed, mm",
    title="A boom bends unseen",
    ylim=(0, None),
)
figure.savefig(picture, dpi=90)
