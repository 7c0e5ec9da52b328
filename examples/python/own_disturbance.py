"""A disturbance of your own: the load at the tool changes, and the encoders do not see how the boom bends.

Prints how far the tool really is from where the controller believes it to be, load by load.
"""

import numpy as np

import longreach

with longreach.lockstep(seed=1) as rig:
    rig.enable()
    misses_mm = {}
    for load_kg in (0.0, 50.0, 100.0):
        rig.plant.set_payload(load_kg)
        reached = rig.run("move", offset_base_m=[0.0, 0.0, 0.01])
        misses_mm[load_kg] = 1e3 * float(np.linalg.norm(rig.truth.X_BT[:3, 3] - reached.X_BT[:3, 3]))

for load_kg, miss_mm in misses_mm.items():
    print(f"{load_kg:5.0f} kg: {miss_mm:5.1f} mm from where the controller believes the tool to be")
