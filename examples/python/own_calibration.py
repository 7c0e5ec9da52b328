"""A calibration of your own: three strokes tell how the camera is turned, and the tool drives to the object.

Prints the true error before and after the one step that rests on it, and draws both.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import longreach
from longreach.rigs import SimulatedRig

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "own_calibration.png")
STROKE_M = 0.1
CLEARANCE_M = 0.1  # between marker and object along the camera's z axis, as configured


def true_error_mm(rig: SimulatedRig) -> np.ndarray:
    """What is left to drive, in camera axes; only the plant knows it."""
    return 1e3 * (rig.truth.p_CO - rig.truth.p_CM - [0.0, 0.0, CLEARANCE_M])


with longreach.lockstep(seed=1) as rig:
    rig.enable()
    before = true_error_mm(rig)
    look = rig.look()
    strokes, seen = [], []
    for stroke in STROKE_M * np.eye(3):
        last = look.look
        rig.run("move", offset_base_m=stroke.tolist())
        look = rig.look()
        strokes.append(look.look.X_BT[:3, 3] - last.X_BT[:3, 3])
        seen.append(last.X_CO[:3, 3] - look.look.X_CO[:3, 3])  # the object goes the other way
    U, _, Vt = np.linalg.svd(np.array(strokes).T @ np.array(seen))  # Procrustes: stroke = R_BC seen
    R_BC = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    rig.run("move", offset_base_m=(R_BC @ look.verdict.error_m).tolist())
    after = true_error_mm(rig)

print(f"true error before: {before.round(1)} mm, after one step: {after.round(1)} mm")

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for label, error in (("before", before), ("after one step", after)):
    axes.bar([f"{axis}, {label}" for axis in "xyz"], np.abs(error), label=label)
axes.set(yscale="log", ylabel="|true error|, mm", title="Three strokes and one step")
axes.tick_params(axis="x", rotation=30)
axes.axhline(5.0, color="black", linestyle=":")  # the tolerance
figure.savefig(picture, dpi=90)
