"""An arm of your own: its reach from its description alone, and one motion of it on the emulated oil.

Prints how far the tool ends from where it was sent; draws where the tools of all shipped arms can be.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import longreach

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "own_arm.png")
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name in ("rock_breaker", "long_crane", "default"):  # or a directory of your own: "./my_arm"
    arm = longreach.arm(name)
    lower, upper = np.radians([(joint.lower_deg, joint.upper_deg) for joint in arm.description.joints]).T
    lower[0] = upper[0] = 0.0  # in the plane of the boom
    drawn = np.random.default_rng(1).uniform(lower, upper, (3000, 6))
    places = np.array([arm.fk(q)[:3, 3] for q in drawn])
    axes.plot(np.hypot(places[:, 0], places[:, 1]), places[:, 2], ".", markersize=2, label=name)
axes.set(xlabel="from the slew axis, m", ylabel="height, m", aspect="equal", title="Where the tool can be")
axes.legend(markerscale=6)
figure.savefig(picture, dpi=90)

with longreach.lockstep(arm="rock_breaker", seed=1) as rig:
    rig.enable()
    before = rig.truth.X_BT[:3, 3]
    rig.run("move", offset_base_m=[0.0, 0.0, 0.05])
    moved_mm = 1e3 * (rig.truth.X_BT[:3, 3] - before)

print(f"sent 50.0 mm up, the true tool moved {np.linalg.norm(moved_mm):.1f} mm, {moved_mm[2]:.1f} of them up")
