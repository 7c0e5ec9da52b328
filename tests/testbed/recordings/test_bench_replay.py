"""A thousand frames of a moving arm replayed: all identical, and how fast beside real time."""

import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from testbed.lockstep.clock import run
from testbed.lockstep.recordings import TRUTH, VISION
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.recordings.comparison import ReplayComparison
from testbed.recordings.perception_replay import FRAME, PerceptionReplay, pixels_for
from testbed.recordings.recorded_vision import recorded_vision
from testbed.scenarios.settings import load_settings
from tests.support.paths import CONFIGS
from vision_pc.core.se3 import Array

FRAMES = 1000
RAW_FRAMES = 100
STEP_M = 0.04


async def watched(rig: LockstepRig, frames: int) -> None:
    """The arm to and fro in every direction, watched with markers and odometry."""
    arm, eyes = rig.application.arm, rig.application.eyes
    home = (await arm.view()).X_BT
    async with eyes.watch(markers=True, odometry=True) as watch:
        for number in range(frames):
            if len(watch.samples) >= frames:
                return
            await arm.move_to(beside(home, number), 2.0)


def beside(home: Array, number: int) -> Array:
    X_BT = home.copy()
    if number % 2 == 0:
        X_BT[:3, 3] += STEP_M * np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 1)][number // 2 % 4])
    return X_BT


def recorded(directory: Path, images: str, frames: int) -> Path:
    settings = load_settings(CONFIGS, {"vision": {"recording": {"images": images}}})
    rig = LockstepRig(settings, 40_016, RunLog())
    with closing(rig.record_in(directory, "bench")):
        rig.command("enable")
        run(rig.application.eyes.look())
        run(watched(rig, frames))
        run(rig.application.eyes.look())
    return directory / VISION


def replayed(path: Path, truth: Path | None) -> tuple[ReplayComparison, float, float]:
    """What came out, CPU seconds of this process, and the arm's own seconds."""
    recording = recorded_vision(path)
    times: list[int] = []
    began_s = time.process_time()
    compared = PerceptionReplay(recording, pixels_for(recording, truth)).run(times.append)
    return compared, time.process_time() - began_s, 1e-9 * (times[-1] - times[0])


@pytest.mark.bench
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("images", "frames"), [("none", FRAMES), ("raw", RAW_FRAMES)])
def test_a_thousand_frames_come_out_identical(tmp_path: Path, images: str, frames: int) -> None:
    path = recorded(tmp_path, images, frames)
    compared, cpu_s, arm_s = replayed(path, tmp_path / TRUTH if images == "none" else None)
    sizes = {part.name: part.stat().st_size * 6e-5 / arm_s for part in tmp_path.rglob("*.mcap")}
    counts = (f"{n} of {compared.of[kind]} {kind}" for kind, n in compared.alike.items())
    print(f"\n{images}: " + ", ".join(counts))
    print(f"{arm_s:.1f} s of arm time in {cpu_s:.1f} s of one core: {arm_s / cpu_s:.1f} times real time")
    print(", ".join(f"{name} {mb:.1f} MB/min" for name, mb in sizes.items()))
    assert compared.first is None
    assert compared.alike == compared.of
    assert compared.of[FRAME] >= frames
    assert images == "none" or arm_s / cpu_s > 3.0
    assert images == "raw" or sum(sizes.values()) < 15.0
