"""Replay a recording: a look in simulated time, and vision's perception over it again, to the last bit.

Prints whether all came out as recorded; draws the true height of the tool from the plant's own recording.
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import longreach
from testbed.recordings.command import run_replay

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "replay_a_recording.png")
with tempfile.TemporaryDirectory() as directory:
    run = Path(directory)
    with longreach.lockstep(seed=1) as rig:
        recordings = rig.lockstep_rig.record_in(run, "replay_a_recording")
        rig.enable()
        rig.run("move", offset_base_m=[0.0, 0.0, 0.03])
        rig.look()
        recordings.close()
    (truth,), (vision,) = run.rglob("truth.mcap"), run.rglob("vision.mcap")
    same = run_replay(vision, truth)
    recorded = longreach.read(truth)["/plant/truth"]

time_s = 1e-9 * (recorded["time_ns"] - recorded["time_ns"][0])
height_mm = 1e3 * (recorded["X_BT"] - recorded["X_BT"][0])[:, 2, 3]
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.plot(time_s, height_mm)
axes.set(xlabel="time, s", ylabel="height of the true tool, mm", title="30 mm up, as the plant recorded it")
figure.savefig(picture, dpi=90)
print(
    f"{len(time_s)} rows of truth, {height_mm[-1]:.1f} mm up; replayed {'as' if same else 'NOT as'} recorded"
)
