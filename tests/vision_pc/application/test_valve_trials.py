"""The program that watches a controller try out its valves, in lockstep, and what it refuses."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import pytest

from foundation.configuration import parse_overrides
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import GroupState
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.reporting.console import QuietBar, bars
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.valve_trials import TrialsSeen, trials_json

pytestmark = pytest.mark.timeout(600)  # a minute of arm time, on a busy machine


class SilentEyes:
    """Eyes that once hear nothing more of the camera, and if it is ``dead`` never again."""

    def __init__(self, rig: LockstepRig, after: int, dead: bool) -> None:
        self._rig, self._eyes, self._after, self._dead = rig, rig.application.eyes, after, dead
        self._silent = False

    @asynccontextmanager
    async def watch(self, **wanted: bool) -> AsyncIterator[Any]:
        if self._silent and self._dead:
            for _ in range(100):  # as long as a camera is waited for
                await self._rig.link.next_state()
            raise LinkLost("link.camera_silent", "newest picture is 1728 ms old, limit 1000 ms")
        async with self._eyes.watch(**wanted) as watch:
            yield SilentWatch(self, watch)

    def refuse(self, count: int) -> None:
        if count >= self._after and not self._silent:
            self._silent = True
            raise LinkLost("link.camera_silent", "newest picture is 1728 ms old, limit 1000 ms")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._eyes, name)


class SilentWatch:
    def __init__(self, eyes: SilentEyes, watch: Any) -> None:
        self._eyes, self._watch = eyes, watch

    async def after(self, count: int, timeout_s: float) -> Any:
        self._eyes.refuse(count)
        return await self._watch.after(count, timeout_s)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._watch, name)


def watched(
    *assignments: str,
    silent_after: int | None = None,
    dead: bool = False,
    notes: list[str] | None = None,
) -> tuple[LockstepRig, TrialsSeen]:
    settings = load_settings(CONFIGS, parse_overrides(["controller.cycle_ms=10", *assignments]))
    sight = partial(simulated_sight, model=load_eye_model(CONFIGS), seed=1)
    rig = LockstepRig(settings, 1, RunLog(), sight)
    if silent_after is not None:
        rig.application.eyes = SilentEyes(rig, silent_after, dead)
    bar = QuietBar()
    if notes is not None:
        bar.update = lambda fraction, note="": notes.append(note)  # type: ignore[method-assign]
    return rig, rig.operate("valve-trials", {"confirmed": True}, bar)


@pytest.mark.slow("a minute of arm time")
def test_play_and_delay_are_found_and_the_arm_is_left_disabled() -> None:
    notes: list[str] = []
    rig, found = watched(
        "controller.excitation.enabled=true",
        "controller.excitation.joints=[5]",
        "controller.excitation.ramps=2",
        "scene.camera.stamps.delay_ms=12",
        notes=notes,
    )
    assert rig.link.state.group_state is GroupState.DISABLED
    pictures = [int(note.split()[1]) for note in notes if note.endswith("pictures")]
    assert pictures[-1] > 100
    assert len(set(pictures)) <= pictures[-1] // 10 + 1, "an operation keeps each note that is new"
    told = trials_json(found)
    assert list(told["play_mrad"]) == ["wrist3"]
    play, late = told["play_mrad"]["wrist3"], told["camera_delay_ms"]
    true = rig.world.settings.plant.errors.backlash.half_width_mrad[5]
    assert play["value"] == pytest.approx(true, rel=0.2)
    assert abs(play["value"] - true) < 4.0 * play["std"]
    assert late["value"] == pytest.approx(12.0, abs=3.0)


def test_a_controller_in_no_such_mode_is_named_and_not_enabled() -> None:
    settings = load_settings(CONFIGS, parse_overrides(["controller.cycle_ms=10"]))
    log, sight = RunLog(), partial(simulated_sight, model=load_eye_model(CONFIGS), seed=1)
    rig = LockstepRig(settings, 1, log, sight)
    with (
        pytest.raises(RequestRefused, match="not started to try out its valves") as raised,
        bars(quiet=True) as shown,
        shown.step("valve-trials") as bar,
    ):
        rig.operate("valve-trials", {"confirmed": True}, bar)
    assert raised.value.cause == "refused.no_trials"
    assert [event for event in log.events if "STANDBY" in str(event)] == []  # it was never enabled


@pytest.mark.slow("a minute of arm time")
def test_a_silent_camera_costs_the_joint_that_was_tried_out_meanwhile() -> None:
    trials = ("controller.excitation.enabled=true", "controller.excitation.joints=[4, 5]")
    rig, found = watched(*trials, "controller.excitation.ramps=2", silent_after=100)
    assert rig.link.state.group_state is GroupState.DISABLED
    assert list(found.plays) == ["wrist3"]
    assert list(found.unseen) == ["wrist2"]
    assert found.unseen["wrist2"].startswith("no picture for ")


def test_a_camera_that_stays_silent_ends_the_trials() -> None:
    with pytest.raises(LinkLost) as raised:
        watched("controller.excitation.enabled=true", silent_after=20, dead=True)
    assert raised.value.cause == "link.camera_silent"
