"""How fast simulated time passes in lockstep on one core, with pixels and without, and what takes it."""

import functools
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import pytest

from laboratory.experiments.positioning.corrected_run import prepared
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.plant import Plant
from protocol.faults import CommandCode, GroupState
from protocol.reference_messages import Command, ReferencePath
from testbed.demonstration.sequence import Recorder, demonstrate
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import SimulatedSensor
from testbed.lockstep.simulated_odometry import ModelOdometry
from testbed.lockstep.world import ControllerSide, World
from testbed.reporting.console import bars
from testbed.scenarios.scenario import Settings, chosen_overrides, load_settings
from tests.support.paths import CONFIGS
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.pixel_sensor import PixelSensor

pytestmark = [pytest.mark.usefixtures("one_core"), pytest.mark.bench, pytest.mark.timeout(1800)]

MOST_REST = 0.25  # of the whole: what is neither plant nor controller, renderer, markers nor odometry
SECONDS = 20.0
PARTS: dict[str, list[tuple[type, str]]] = {
    "plant": [(Plant, "advance"), (Plant, "read"), (Plant, "write"), (Plant, "truth")],
    "controller": [(ControllerSide, "cycle")],
    "renderer": [(StereoCamera, "take")],
    "markers": [(PixelSensor, "observe"), (SimulatedSensor, "observe")],
    "odometry": [(StereoOdometry, "process"), (ModelOdometry, "process")],
}


class Spent(NamedTuple):
    """Processor time of a piece of work, s, and how much of it each part took, in how many calls."""

    simulated_s: float
    spent_s: float
    parts_s: Counter[str]
    calls: Counter[str]


@contextmanager
def parts_timed() -> Iterator[tuple[Counter[str], Counter[str]]]:
    """Processor time (s) and calls of each part, while inside; a part called by another counts for itself."""
    spent: Counter[str] = Counter()
    calls: Counter[str] = Counter()
    with pytest.MonkeyPatch.context() as patch:
        for part, places in PARTS.items():
            for owner, name in places:
                patch.setattr(owner, name, timed(getattr(owner, name), part, spent, calls))
        yield spent, calls


def timed(
    function: Callable[..., Any], part: str, spent: Counter[str], calls: Counter[str]
) -> Callable[..., Any]:
    """``function`` that adds what it takes to ``spent`` of ``part``."""

    @functools.wraps(function)
    def meter(*arguments: Any, **named: Any) -> Any:
        began, before_s = time.process_time_ns(), sum(spent.values())
        try:
            return function(*arguments, **named)
        finally:
            own_s = 1e-9 * (time.process_time_ns() - began) - sum(spent.values()) + before_s
            spent[part] += own_s  # type: ignore[assignment]
            calls[part] += 1

    return meter


def measured(world: World, work: Callable[[], None]) -> Spent:
    """What ``work`` in ``world`` takes."""
    began_ns, began = world.time_ns, time.process_time()
    with parts_timed() as (parts, calls):
        work()
    return Spent(1e-9 * (world.time_ns - began_ns), time.process_time() - began, parts, calls)


def report(what: str, spent: Spent) -> float:
    """Print a table of ``spent``; returns the share of lockstep itself, beside what it steps."""
    each_ms = 1e3 / spent.simulated_s
    rest = spent.spent_s - sum(spent.parts_s.values())
    print(f"\nlockstep {what}, 5 ms cycle, one core: {spent.simulated_s / spent.spent_s:.1f} times real time")
    print("  part         ms a simulated second   share   ms a call   calls")
    for part, seconds in [*spent.parts_s.most_common(), ("rest", rest)]:
        calls = spent.calls[part]
        each = f"{1e3 * seconds / calls:11.3f} {calls:7d}" if calls else ""
        print(f"  {part:12s} {each_ms * seconds:21.1f} {100 * seconds / spent.spent_s:6.0f} % {each}")
    return rest / spent.spent_s


def standard() -> Settings:
    return load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", 1, ["controller.cycle_ms=5.0"]))


def standard_rig() -> LockstepRig:
    return LockstepRig(standard(), 1, RunLog())


@pytest.fixture
def moving_world() -> Iterator[World]:
    world = World(standard(), 1, RunLog())
    world.connect()
    world.link.submit(Command(0, CommandCode.ENABLE))
    for _ in range(100):
        world.clock.advance()
    here = world.states[-1].X_BT
    x, y, z = here.p_m
    corners = [(x, y + 0.2, z), (x, y - 0.2, z)] * 12
    world.link.submit(ReferencePath(0, tuple(here._replace(p_m=corner) for corner in corners), 0.0, 0.0))
    for _ in range(20):
        world.clock.advance()
    yield world
    assert world.states[-1].group_state is GroupState.MOVING, "the arm must have been moving all the time"


def test_lockstep_without_pixels(moving_world: World) -> None:
    cycles = round(SECONDS / 0.005)

    def move() -> None:
        for _ in range(cycles // 4):
            moving_world.clock.advance()

    # the best of three: the others tell of other work on the machine
    spent = min((measured(moving_world, move) for _ in range(3)), key=lambda one: one.spent_s)
    assert report("without pixels, in motion", spent) <= MOST_REST


def test_the_demonstration_with_pixels() -> None:
    warm()
    rig = standard_rig()

    def demonstration() -> None:
        with bars(quiet=True) as shown:
            demonstrate(Recorder(rig, shown), 1)

    spent = measured(rig.world, demonstration)
    assert report("with pixels, the demonstration", spent) <= MOST_REST


def test_every_picture_rendered_and_followed() -> None:
    warm()
    rig = standard_rig()
    rig.command("enable")

    def follow() -> None:
        with bars(quiet=True) as shown, shown.step("local track") as bar:
            rig.operate("look", {"frames": 3}, bar)
            rig.operate("local-track", {"leg_m": 0.1}, bar)

    spent = measured(rig.world, follow)
    assert report("with every picture followed", spent) <= MOST_REST


def test_a_real_machine_seen_by_the_eye_model() -> None:
    task = {"seed": 8531, "arm": "plant", "world": "real", "eyes": "model", "assignments": []}
    rig = prepared(CONFIGS, task | {"adapting": True, "commissioned": True})  # which compiles what it needs

    def follow() -> None:
        with bars(quiet=True) as shown, shown.step("local track") as bar:
            rig.operate("local-track", {}, bar)

    spent = measured(rig.world, follow)
    assert report("of a real machine, eye model", spent) <= MOST_REST


def warm() -> None:
    """Compile what pictures need, and paint the wall's texture, which is kept for the next camera."""
    rig = standard_rig()
    rig.command("enable")
    with bars(quiet=True) as shown, shown.step("warm up") as bar:
        rig.operate("look", {"frames": 2}, bar)
        rig.operate("local-track", {"leg_m": 0.05}, bar)
