"""Replay a recording: a look in simulated time, and vision's perception over it again, to the last bit.

Prints whether all came out as recorded; draws the true height of the tool from the plant's own recording.
"""

import csv
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import longreach
from testbed.recordings.command import ReplayRequest, run_replay
from testbed.recordings.comparison import write_tables

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
    same = run_replay(ReplayRequest(vision, truth, [], None, None))
    tables, _ = write_tables(truth, run / "tables")
    with (run / "tables" / "plant_truth.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))

time_s = [1e-9 * (int(row["time_ns"]) - int(rows[0]["time_ns"])) for row in rows]
height_mm = [1e3 * (float(row["X_BT[11]"]) - float(rows[0]["X_BT[11]"])) for row in rows]  # row 2, column 3
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.plot(time_s, height_mm)
axes.set(xlabel="time, s", ylabel="height of the true tool, mm", title="30 mm up, as the plant recorded it")
figure.savefig(picture, dpi=90)
print(f"{len(rows)} rows of truth, {height_mm[-1]:.1f} mm up; replayed {'as' if same else 'NOT as'} recorded")
