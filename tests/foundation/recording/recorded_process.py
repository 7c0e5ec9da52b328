"""``python -m tests.foundation.recording.recorded_process PART FILE`` records as that part's service does, at
its rates, until it is killed, and says on stdout when it put each truth, scan or frame with its pixels.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import NamedTuple

from controller.shell.scan_recorder import STATE, ScanRecorder
from foundation.configuration import load
from foundation.event_log import EventLog
from nominal_arm.description import NominalArm
from plant_emulator.shell.truth_recorder import TRUTH, TruthRecorder
from tests.controller.shell.test_scan_recorder import config_of, scans
from tests.plant_emulator.shell.test_recording import truth
from tests.support.paths import CONFIGS
from tests.vision_pc.shell.recording.test_bench_vision_recorder import CONFIG, frames, measured
from vision_pc.shell.recording.vision_messages import ToldWithFrame
from vision_pc.shell.recording.vision_recorder import FRAME, VisionRecorder

Put = Callable[[int], None]


class Recorded(NamedTuple):
    """A part's own recorder: the topic that is looked for, how often it is put, and what puts it."""

    topic: str
    period_s: float
    begin: Callable[[Path], Put]


def _plant(path: Path) -> Put:
    truths = [truth(number) for number in range(20)]
    recorder = TruthRecorder(path, {})
    numbers = count()

    def put(now_ns: int) -> None:
        number = next(numbers)
        recorder.truth(truths[number % 20]._replace(time_ns=number), now_ns)

    return put


def _controller(path: Path) -> Put:
    arm = load(NominalArm, CONFIGS / "arm.yaml")
    made = scans(arm, 20)
    path.parent.mkdir(exist_ok=True)
    recorder = ScanRecorder(path.parent, arm, config_of(200.0), EventLog("controller"))
    numbers = count()

    def put(now_ns: int) -> None:
        inputs, output = made[next(numbers) % 20]
        recorder.scan(inputs._replace(now_ns=now_ns), output)

    return put


def _vision(path: Path) -> Put:
    raw = CONFIG.recording.model_copy(update={"images": "raw"})
    config = CONFIG.model_copy(update={"recording": raw})
    now: list[int] = []
    recorder = VisionRecorder(path, config, {}, {}, lambda: now[-1])
    kept = frames()
    numbers: Iterator[int] = count()

    def put(now_ns: int) -> None:
        number = next(numbers)
        now[:] = [now_ns]
        pair = kept[number % len(kept)]._replace(capture_ns=now_ns, frame_id=number)
        seen, pose = measured(pair)
        recorder.observed(pair, None, seen)
        recorder.tracked(1, pair, ToldWithFrame(False, None), pose)

    return put


PARTS = {
    "plant": Recorded(TRUTH, 0.016, _plant),
    "controller": Recorded(STATE, 0.005, _controller),
    "vision": Recorded(FRAME, 0.1, _vision),
}


def main(part: str, path: Path) -> None:
    """Record until killed."""
    put = PARTS[part].begin(path)
    while True:
        now_ns = time.monotonic_ns()
        put(now_ns)
        os.write(sys.stdout.fileno(), f"{now_ns}\n".encode())
        time.sleep(PARTS[part].period_s)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
