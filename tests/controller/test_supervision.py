"""Faults: recognised in time, latched as the first, answered as their severity says; judged at the valves."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.settings import ScanSettings, settings_from
from controller.core.supervision import FAULTS, REACTIONS
from nominal_arm.description import NominalArm
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.process_image import (
    CONTROL_ENABLE,
    STATUS_SENSOR_FAULT,
    STATUS_SUPPLY_ON,
    STATUS_WATCHDOG_TRIPPED,
)
from protocol.reference_messages import FLAG_PLANT_LINK_OK
from tests.controller.obedient_plant import Bench

ZERO = (0.0,) * 6


def _until_fault(bench: Bench, most_s: float) -> float:
    """Seconds until a fault is latched."""
    for scans in range(round(most_s / bench.settings.cycle_s)):
        if bench.step().view.fault is not FaultCode.NONE:
            return (scans + 1) * bench.settings.cycle_s
    raise AssertionError("no fault")


def _jump(bench: Bench) -> None:
    bench.stuck = True
    bench.q = (*bench.q[:5], bench.q[5] + 0.05)


def _set(name: str, value: object) -> Callable[[Bench], None]:
    return lambda bench: setattr(bench, name, value)


@pytest.mark.parametrize(
    ("spoil", "fault", "within_s"),
    [
        (_set("silent", True), FaultCode.PLANT_LINK_LOST, 0.06),
        (_set("deaf", True), FaultCode.PLANT_LINK_LOST, 0.06),
        (_set("frozen", True), FaultCode.PLANT_CYCLE_FROZEN, 0.11),
        (_set("stuck", True), FaultCode.ENCODER_STUCK, 2.0),
        (_jump, FaultCode.ENCODER_JUMP, 0.01),
        (_set("status", STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED), FaultCode.PLANT_WATCHDOG, 0.01),
        (_set("status", STATUS_SUPPLY_ON | STATUS_SENSOR_FAULT), FaultCode.PLANT_STATUS, 0.01),
        (_set("status", 0), FaultCode.SUPPLY_PRESSURE_LOST, 0.21),
        (_set("supply_bar", 40.0), FaultCode.SUPPLY_PRESSURE_LOST, 0.21),
        (_set("enables", False), FaultCode.PLANT_STATUS, 0.26),
        (_set("late_s", 0.2), FaultCode.OVERRUN, 0.01),
    ],
)
def test_faults_centre_the_valves_in_the_same_scan(
    settings: ScanSettings, spoil: Callable[[Bench], None], fault: FaultCode, within_s: float
) -> None:
    bench = Bench(settings).moving()
    spoil(bench)
    assert _until_fault(bench, 3.0) <= within_s + 1e-9
    view, valves = bench.last.view, bench.last.valves
    assert (view.fault, view.severity) == (fault, Severity.EMERGENCY)
    assert view.group_state is GroupState.ERROR_STOP
    assert (valves.valves, valves.control & CONTROL_ENABLE) == (ZERO, 0)
    assert any(event.name == "fault" and event.cause == fault.name for event in bench.last.events)


def test_a_few_missed_exchanges_are_survived_and_counted(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    for _ in range(3):
        bench.silent = True
        bench.run(0.02)
        bench.silent = False
        bench.run(0.1)
    assert bench.last.view.fault is FaultCode.NONE
    assert bench.last.view.plant_exchange_failures == 12
    bench.run(6.0)
    assert bench.last.view.motion_done


def test_the_first_fault_stays_while_the_reaction_follows_the_gravest(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    bench.link_alive = False
    bench.step()
    assert bench.state.mode is Mode.ERROR_RAMP
    bench.silent = True
    bench.run(0.1)
    assert bench.last.view.fault is FaultCode.REFERENCE_LINK_LOST
    assert bench.last.view.severity is Severity.EMERGENCY
    assert (bench.last.valves.valves, bench.last.valves.control) == (ZERO, 0)


def test_a_tool_that_runs_away_is_overspeed(arm: NominalArm, config: ControllerConfig) -> None:
    wide = config.supervision.model_copy(update={"following_error_deg": (80.0,) * 6})
    bench = Bench(settings_from(arm, config.model_copy(update={"supervision": wide}))).enabled()
    bench.stuck = True
    for _ in range(60):
        bench.q = (bench.q[0] + 0.3 * bench.settings.cycle_s, *bench.q[1:])  # 0.3 rad/s at 4 m
        bench.step()
    assert bench.last.view.fault is FaultCode.OVERSPEED


def _drifting(bench: Bench, joint: int, rad_per_scan: float) -> None:
    """Scans in which the plant strays further and further above its command, until a fault."""
    for scans in range(400):
        stray = [0.0] * 6
        stray[joint] = scans * rad_per_scan
        bench.offset = tuple(stray)
        if bench.step().view.fault is not FaultCode.NONE:
            return
    raise AssertionError("no fault")


def test_a_joint_that_does_not_follow_is_a_following_error(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    _drifting(bench, 5, 2e-3)
    fault = bench.state.fault
    assert (fault.code, bench.last.view.severity) == (FaultCode.FOLLOWING_ERROR, Severity.EMERGENCY)
    assert fault.value > fault.limit == settings.supervision.following_error[5]
    assert (bench.last.valves.valves, bench.last.valves.control) == (ZERO, 0)


def test_a_tool_that_strays_out_of_the_workspace_is_ramped_down(
    arm: NominalArm, config: ControllerConfig
) -> None:
    low = arm.workspace.model_copy(update={"z_m": (-1.0, 1.35)})
    bench = Bench(settings_from(arm.model_copy(update={"workspace": low}), config)).moving()
    _drifting(bench, 1, 3e-4)
    view = bench.last.view
    assert (view.fault, view.severity) == (FaultCode.WORKSPACE_LIMIT, Severity.STOP)
    assert view.X_BT.p_m[2] > 1.35 + config.supervision.workspace_margin_m
    assert bench.state.mode is Mode.ERROR_RAMP


def test_a_joint_that_strays_beyond_its_range_is_ramped_down(
    arm: NominalArm, config: ControllerConfig
) -> None:
    lift = arm.joints[1].model_copy(update={"upper_deg": 55.5})
    joints = (arm.joints[0], lift, *arm.joints[2:])
    bench = Bench(settings_from(arm.model_copy(update={"joints": joints}), config)).moving()
    _drifting(bench, 1, 3e-4)
    fault = bench.state.fault
    assert (fault.code, bench.last.view.severity) == (FaultCode.JOINT_LIMIT, Severity.STOP)
    assert (
        fault.value
        > fault.limit
        == pytest.approx(math.radians(55.5 + config.supervision.joint_overtravel_deg))
    )


def test_a_number_that_is_none_never_reaches_the_valves(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    poisoned = bench.state.servo._replace(q_cmd=np.full(6, math.nan))
    bench.state = bench.state._replace(servo=poisoned)
    bench.step()
    assert bench.last.view.fault is FaultCode.NUMERIC
    assert (bench.last.valves.valves, bench.last.valves.control) == (ZERO, 0)


def test_link_flag_follows_the_link_while_disabled_and_nothing_latches(settings: ScanSettings) -> None:
    bench = Bench(settings)
    bench.run(0.05)
    assert bench.last.view.flags & FLAG_PLANT_LINK_OK
    bench.silent = True
    bench.run(0.5)
    assert not bench.last.view.flags & FLAG_PLANT_LINK_OK
    assert bench.last.view.fault is FaultCode.NONE
    bench.silent = False
    bench.run(0.05)
    assert bench.last.view.flags & FLAG_PLANT_LINK_OK


def test_a_restarted_echo_counts_as_a_dead_link_until_it_has_caught_up(settings: ScanSettings) -> None:
    bench = Bench(settings)
    bench.run(0.5)
    bench.deaf = True
    bench.run(0.5)
    assert not bench.last.view.flags & FLAG_PLANT_LINK_OK
    assert bench.command(CommandCode.ENABLE) is Reason.PLANT_LINK_DOWN
    bench.deaf = False
    bench.step()
    assert bench.command(CommandCode.ENABLE) is Reason.ACCEPTED


def test_every_fault_has_one_reaction() -> None:
    assert set(REACTIONS) == set(FaultCode) - {FaultCode.NONE}
    assert all(REACTIONS[row.code] == row.reaction for row in FAULTS)  # also those with two rows


@pytest.fixture
def quick(arm: NominalArm, config: ControllerConfig) -> ScanSettings:
    """The settings at a cycle of 1 ms."""
    return settings_from(arm, config.model_copy(update={"cycle_ms": 1.0}))


def test_at_a_shorter_cycle_an_outage_may_last_as_long(quick: ScanSettings) -> None:
    """What holds up network and plant counts in time: 50 ms are survived, and not 60."""
    bench = Bench(quick).moving()
    bench.silent = True
    bench.run(0.05)
    assert bench.last.view.fault is FaultCode.NONE
    bench.run(0.01)
    assert bench.last.view.fault is FaultCode.PLANT_LINK_LOST
