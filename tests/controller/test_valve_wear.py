"""Valves that take more spool than their commissioning says are named, those that do not are not."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from controller.core.scan_types import ScanEvent, initial_state
from controller.core.servo.joint_control import opening_for
from controller.core.servo.servo_step import full_spool_speeds
from controller.core.settings import ScanSettings, settings_from
from controller.core.valve_wear import _reported, empty_watch, in_words, watch_wear
from laboratory.experiments.positioning.corrected_run import settings_of
from plant_emulator.core.faults.kinds import ValvesWorn
from plant_emulator.core.plant import Plant
from protocol.axes_group import Mode
from protocol.faults import Reason
from protocol.pose import Pose
from protocol.reference_messages import ReferencePose
from testbed.lockstep.clock import ClosedLoop
from tests.controller.conftest import CONFIGS

MOBILE: dict[str, Any] = {
    "seed": 8701, "arm": "plant", "world": "lab", "eyes": "model", "adapting": True, "commissioned": True,
    "assignments": ["plant.valve_set=mobile"],
}  # fmt: skip
TILT = 2
RATE_RAD_S = 0.05


@pytest.fixture(scope="module")
def settings() -> ScanSettings:
    known = settings_of(CONFIGS, MOBILE)
    return settings_from(known.arm, known.controller)


def events_after(
    settings: ScanSettings, more: float, seconds: float, mode: Mode = Mode.MOVING, sense: float = 1.0
) -> list[ScanEvent]:
    """Events of a tilt that turns evenly on a spool that is ``more`` of its deadband beyond its valve's."""
    servo, side = settings.servo, 0 if sense > 0.0 else 1
    state, watch, events = initial_state(settings), empty_watch(), []
    q, spool = np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0]), np.zeros(6)
    for _ in range(round(seconds / settings.cycle_s)):
        q = q + sense * RATE_RAD_S * settings.cycle_s * np.eye(6)[TILT]
        speeds = full_spool_speeds(servo.drives, q, servo.rated, servo.rated, np.zeros(6))
        edge = servo.joints.deadband[TILT, side]
        flow = RATE_RAD_S / (servo.joints.flow_gain[TILT, side] * speeds[TILT, side])
        opened = edge + opening_for(servo.joints.curve[TILT, side], flow) + more * edge
        spool[TILT] = sense * (opened + servo.joints.half_play[TILT])
        state = state._replace(
            mode=mode,
            watch=state.watch._replace(q_meas=q),
            servo=state.servo._replace(valves=spool.copy()),
        )
        watch, said = watch_wear(settings, watch, state, settings.cycle_s)
        events += said
    return events


@pytest.mark.parametrize("more", [-0.3, 0.0, 0.15])
def test_a_valve_about_as_it_was_found_is_not_named(settings: ScanSettings, more: float) -> None:
    assert events_after(settings, more, 6.0) == []


def test_a_worn_valve_is_named_once_with_its_joint_and_how_much_more_it_takes(settings: ScanSettings) -> None:
    (event,) = events_after(settings, 0.4, 6.0)
    assert (event.name, event.cause) == ("worn", "TILT")
    assert 1.05 < event.limit < event.value < 1.4
    assert in_words(event.cause, 1.31) == (
        "tilt takes 1.31 times the spool that its commissioned valve says: "
        "the valve has worn, commission again"
    )


def test_what_scatters_too_widely_to_be_sure_is_not_named(settings: ScanSettings) -> None:
    """Ten windows, 0.3 of a deadband in the mean: alike they name the joint, from 0 to 0.6 they do not."""
    said = {}
    for apart in (0.0, 0.3):
        watch = empty_watch()
        watch.sums[:, TILT, 0] = (10.0, 3.0, 10.0 * (0.3**2 + apart**2), 1.3, 1.0)
        said[apart] = _reported(settings, watch)[1]
    assert [event.cause for event in said[0.0]] == ["TILT"]
    assert said[0.3] == ()


def test_an_arm_that_makes_no_motion_says_nothing_of_its_valves(settings: ScanSettings) -> None:
    assert events_after(settings, 0.4, 6.0, Mode.STANDBY) == []


def test_a_load_that_comes_down_on_its_load_holding_valve_is_left_out(settings: ScanSettings) -> None:
    assert settings.servo.joints.holding.damping[TILT] > 0.0
    assert events_after(settings, 0.4, 6.0, sense=-1.0) == []


def driven(worn: bool) -> tuple[set[str], float]:
    """Joints named while a machine goes to and fro for a while, and when (s) the first was."""
    drawn = settings_of(CONFIGS, MOBILE)
    plant = Plant(drawn.plant, 8701)
    if worn:
        plant.inject(ValvesWorn())
    loop = ClosedLoop(settings_from(drawn.arm, drawn.controller), plant)
    loop.enable()
    begin, watch, named, first_s = loop.view.X_BT, empty_watch(), set(), 0.0
    for off in (0.2, -0.1, 0.15, 0.0):
        x, y, z = (float(at) for at in np.array(begin.p_m) + off * np.ones(3))
        reference = partial(ReferencePose, X_BT_ref=Pose((x, y, z), begin.q_wxyz), duration_s=0.0)
        assert loop.refer(reference) is Reason.ACCEPTED
        while not loop.view.motion_done:
            loop.step()
            watch, said = watch_wear(loop.settings, watch, loop.state, loop.settings.cycle_s)
            if said and not named:
                first_s = 1e-9 * plant.time_ns
            named |= {event.cause for event in said}
    return named, first_s


@pytest.mark.slow("half a minute of arm time, twice")
def test_valves_that_have_worn_are_named_within_a_minute_and_healthy_ones_are_not() -> None:
    assert driven(worn=False) == (set(), 0.0)
    named, first_s = driven(worn=True)
    print(f"named after {first_s:.0f} s: {sorted(named)}")
    assert named
    assert first_s < 60.0
