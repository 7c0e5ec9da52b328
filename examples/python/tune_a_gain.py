"""Tune a gain: the same motion with three gains of the lift joint, each in the same world.

Prints the greatest lag behind the reference, gain by gain; draws the ways.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import longreach

LIFT = 1  # in arm.yaml's order of the joints
picture = Path(sys.argv[1] if len(sys.argv) > 1 else "tune_a_gain.png")
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for gain in (1.0, 2.0, 3.5):
    gains = [2.3, gain, 4.2, 17.0, 17.0, 17.0]
    with longreach.lockstep(seed=1, set={"controller.joint_control.gain_1_s": gains}) as rig:
        rig.enable()
        rig.run("move", offset_base_m=[0.0, 0.0, 0.1])
        states = rig.lockstep_rig.world.states
    time_s = 1e-9 * np.array([state.time_ns for state in states])
    lag_mrad = 1e3 * np.array([state.q_cmd[LIFT] - state.q_meas[LIFT] for state in states])
    axes.plot(time_s - time_s[0], lag_mrad, label=f"{gain:g} 1/s")
    print(f"gain {gain:.1f} 1/s: lag up to {np.abs(lag_mrad).max():.2f} mrad")
axes.set(xlabel="time, s", ylabel="lift behind its reference, mrad", title="100 mm up")
axes.legend()
figure.savefig(picture, dpi=90)
