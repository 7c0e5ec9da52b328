"""A thousand frames of a moving arm replayed: all identical, and how fast beside real time."""

import time
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from protocol.errors import LongreachError
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import TRUTH, VISION, LockstepRig
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.recordings.comparison import OPERATION, REFERENCE, ReplayComparison
from testbed.recordings.decision_replay import DecisionReplay
from testbed.recordings.perception_replay import FRAME, PerceptionReplay, pixels_for
from testbed.recordings.pixels import RenderedAhead, rendered_ahead
from testbed.recordings.recorded_vision import recorded_vision
from testbed.reporting.console import bars
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.bodies import RequestBody
from vision_pc.application.program import Program
from vision_pc.application.programs import PROGRAMS
from vision_pc.core.se3 import Array

FRAMES = 1000
RAW_FRAMES = 100
STEP_M = 0.04
SEED = 40_117
PROCEDURE: tuple[tuple[str, dict[str, Any]], ...] = (
    ("look", {}),
    ("orientation-adjustment", {}),
    ("line-equation", {}),
    ("trajectory-matching", {}),
    ("look-then-move", {}),
    ("local-track", {}),
    ("look-then-move", {"method": "corrected"}),
    ("looking-and-moving", {}),
    ("move", {"offset_base_m": [0.0, 0.0, 0.05]}),
)


async def watched(application: Any, frames: int) -> None:
    """The arm to and fro in every direction, watched with markers and odometry."""
    arm, eyes = application.arm, application.eyes
    home = (await arm.view()).X_BT
    async with eyes.watch(markers=True, odometry=True) as watch:
        for number in range(frames):
            if len(watch.samples) >= frames:
                return
            await arm.move_to(beside(home, number), 2.0)


def to_and_fro(frames: int) -> Program[Any, Any]:
    """Watches ``frames`` frames of a moving arm."""

    async def run_it(application: Any, body: Any, report: Any) -> None:
        await watched(application, frames)

    return Program("to-and-fro", "to and fro", run_it, lambda _: {}, RequestBody, needs=())


def beside(home: Array, number: int) -> Array:
    X_BT = home.copy()
    if number % 2 == 0:
        X_BT[:3, 3] += STEP_M * np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 1)][number // 2 % 4])
    return X_BT


def recorded(directory: Path, images: str, frames: int, seed: int = SEED) -> Path:
    settings = load_settings(CONFIGS, {"vision": {"recording": {"images": images}}})
    rig = LockstepRig(settings, seed, RunLog(), programs=(*PROGRAMS, to_and_fro(frames)))
    with closing(rig.record_in(directory, "bench")), bars(quiet=True) as shown, shown.step("") as bar:
        rig.command("enable")
        for kind in ("look", "to-and-fro", "look"):
            rig.operate(kind, {}, bar)
    return directory / VISION


class Replayed(NamedTuple):
    """What came out, CPU seconds of this process and of the one that renders, wall and arm's own seconds."""

    compared: ReplayComparison
    cpu_s: float
    beside_s: float
    wall_s: float
    arm_s: float


def replayed(path: Path, truth: Path | None) -> Replayed:
    recording = recorded_vision(path)
    times: list[int] = []
    began_s, since_s = time.process_time(), time.monotonic()
    with rendered_ahead(pixels_for(recording, truth), path) as pixels:
        compared = PerceptionReplay(recording, pixels).run(times.append)
    cpu_s, wall_s = time.process_time() - began_s, time.monotonic() - since_s
    beside_s = pixels.cpu_s if isinstance(pixels, RenderedAhead) else 0.0
    return Replayed(compared, cpu_s, beside_s, wall_s, 1e-9 * (times[-1] - times[0]))


def decided_again(path: Path, programs: tuple[Program[Any, Any], ...] = PROGRAMS) -> ReplayComparison:
    """What comes out when the programs are run again; all must be as recorded."""
    began_s = time.process_time()
    replay = DecisionReplay(recorded_vision(path), programs)
    compared = replay.run()
    counts = (f"{n} of {compared.of[kind]} {kind}s" for kind, n in compared.alike.items())
    print(f"decided again in {time.process_time() - began_s:.1f} s: " + ", ".join(counts))
    assert compared.first is None
    assert compared.alike == compared.of
    assert not replay.not_run
    return compared


@pytest.mark.bench
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_replayed_programs_send_the_same_references(tmp_path: Path, seed: int) -> None:
    """Every program that moves the arm by what it sees, over eyes without pictures."""
    sight = partial(simulated_sight, model=load_eye_model(CONFIGS), seed=seed)
    rig = LockstepRig(load_settings(CONFIGS, {}), seed, RunLog(), sight)
    with closing(rig.record_in(tmp_path, "bench")), bars(quiet=True) as shown, shown.step("") as bar:
        rig.command("enable")
        for kind, body in PROCEDURE:
            with suppress(LongreachError):  # one that fails is to fail again
                rig.operate(kind, body, bar)
    print()
    compared = decided_again(tmp_path / VISION)
    assert compared.of[OPERATION] == len(PROCEDURE)


@pytest.mark.bench
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("images", "frames"), [("none", FRAMES), ("raw", RAW_FRAMES)])
def test_a_thousand_frames_come_out_identical(tmp_path: Path, images: str, frames: int) -> None:
    began_s = time.process_time()
    path = recorded(tmp_path, images, frames)
    recording_s = time.process_time() - began_s
    made = replayed(path, tmp_path / TRUTH if images == "none" else None)
    compared, arm_s, busiest_s = made.compared, made.arm_s, max(made.cpu_s, made.beside_s)
    sizes = {part.name: part.stat().st_size * 6e-5 / arm_s for part in tmp_path.rglob("*.mcap")}
    counts = (f"{n} of {compared.of[kind]} {kind}" for kind, n in compared.alike.items())
    print(f"\n{images}: " + ", ".join(counts))
    print(
        f"{arm_s:.1f} s of arm time in {made.cpu_s:.1f} s of one core, {made.beside_s:.1f} s of another,",
        end=" ",
    )
    print(f"{made.wall_s:.1f} s by the clock: {arm_s / busiest_s:.1f} times real time on cores of its own")
    print(", ".join(f"{name} {mb:.1f} MB/min" for name, mb in sizes.items()))
    decided = decided_again(path, (*PROGRAMS, to_and_fro(frames)))
    assert decided.of[REFERENCE] >= frames // 100  # a motion takes seven seconds with its settling
    assert compared.first is None
    assert compared.alike == compared.of
    assert compared.of[FRAME] >= frames
    assert busiest_s < recording_s  # in lockstep, with all three services
    assert images == "raw" or sum(sizes.values()) < 15.0
