"""Faults: what the controller watches while it drives the valves, and how it reacts to each.

FAULTS has one row a fault: what gives it away with which limit, and the reaction. Every reaction drops the
enable in the end; the first cause is latched.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from controller.core.group_states import Stimulus
from controller.core.kinematics.rotations import Array, norm
from controller.core.plant_watch import PlantWatch, cycle_frozen, link_lost
from controller.core.servo.servo_step import ToolState
from controller.core.settings import ScanSettings, SupervisionLimits
from controller.core.trajectories.workspace import outside
from foundation.compiled import kernel
from protocol.faults import FaultCode, Severity
from protocol.process_image import (
    STATUS_SENSOR_FAULT,
    STATUS_SUPPLY_ON,
    STATUS_VALVES_ENABLED,
    STATUS_WATCHDOG_TRIPPED,
)

_PA_PER_BAR = 1e5
_AHEAD_S = 0.1  # [D] a tool outside the workspace that is nearer to it after this time comes back

ValueAndLimit = tuple[float, float]
Sextet = tuple[bool, bool, bool, bool, bool, bool]


class Fault(NamedTuple):
    """A fault's code with the value that gave it away and the limit it broke (SI)."""

    code: FaultCode
    value: float
    limit: float


class Timers(NamedTuple):
    """How long (s) a condition has lasted that is a fault only when it lasts."""

    supply_low: float
    not_enabled: float
    overspeed: float
    stuck: tuple[float, ...]


RESTED = Timers(0.0, 0.0, 0.0, (0.0,) * 6)


class ServoOutput(NamedTuple):
    """What the servo commanded in the last scan; supervision judges the plant's answer against it."""

    q_cmd: Array
    qd_cmd: Array
    valves: Array
    v_desired: Array


class Readings(NamedTuple):
    """What the arrays of one scan say, as numbers (SI).

    ``speed``: of the tool. ``finite``: whether all commands are. ``leap``: the furthest that a joint turned.
    ``behind``: the command's lead over the joint that breaks its limit most, or comes nearest to it.
    ``overtravel``: the first joint's angle that is driven out of its range, and ``outside``: the tool's
    coordinate that left the workspace, each with its bound; equal when there is none. ``still``: whether a
    joint did not turn although its valve is open.
    """

    speed: float
    finite: bool
    leap: float
    behind: ValueAndLimit
    overtravel: ValueAndLimit
    outside: ValueAndLimit
    still: Sextet


class Evidence(NamedTuple):
    """What one scan is judged by. ``p_BT`` (3,) is the tool's."""

    settings: ScanSettings
    watch: PlantWatch
    timers: Timers
    servo: ServoOutput
    p_BT: Array
    found: Readings
    dt_s: float


class Reaction(NamedTuple):
    """The severity that is reported, and what happens to the group's state."""

    severity: Severity
    stimulus: Stimulus


class FaultRow(NamedTuple):
    """One fault. ``found``: value and limit while the fault is present, else None; where there is no such
    function, the scan finds the fault elsewhere (a command, a silent link).
    """

    code: FaultCode
    reaction: Reaction
    found: Callable[[Evidence], ValueAndLimit | None] | None = None


def plant_ready(settings: ScanSettings, watch: PlantWatch) -> bool:
    """Whether the plant may be enabled: supply on, no sensor fault, no tripped watchdog."""
    if watch.sensors is None:
        return False
    status = watch.sensors.status
    return bool(
        status & STATUS_SUPPLY_ON
        and not status & (STATUS_SENSOR_FAULT | STATUS_WATCHDOG_TRIPPED)
        and watch.sensors.supply_bar >= settings.supervision.supply_min_bar
    )


def readings(settings: ScanSettings, watch: PlantWatch, servo: ServoOutput, tool: ToolState) -> Readings:
    """The Readings of a scan whose servo has not moved on yet."""
    found = _readings(settings.supervision, tool, servo, watch.q_meas, watch.qd_meas, watch.turned)
    return Readings(*found)


@kernel
def _still(limits: SupervisionLimits, servo: ServoOutput, turned: Array, joint: int) -> bool:
    valve, open_at = servo.valves[joint], limits.encoder_stuck_valves[joint]
    return bool(turned[joint] == 0.0 and (valve > open_at[0] or -valve > open_at[1]))


@kernel
def _readings(
    limits: SupervisionLimits, tool: ToolState, servo: ServoOutput, q: Array, qd: Array, turned: Array
) -> tuple[float, bool, float, ValueAndLimit, ValueAndLimit, ValueAndLimit, Sextet]:
    finite, leap = True, 0.0
    behind, at_most, worst = 0.0, limits.following_error[0], -1.0
    overtravel = 0.0, 0.0
    for i in range(6):
        finite = finite and np.isfinite(servo.q_cmd[i]) and np.isfinite(servo.valves[i])
        leap = max(leap, abs(turned[i]))
        lead = abs(servo.q_cmd[i] - q[i])
        if lead / limits.following_error[i] > worst:
            behind, at_most, worst = lead, limits.following_error[i], lead / limits.following_error[i]
        lower, upper, speed = limits.overtravel_range[0, i], limits.overtravel_range[1, i], servo.qd_cmd[i]
        if overtravel[0] == overtravel[1] and q[i] < lower and speed < 0.0:
            overtravel = q[i], lower
        elif overtravel[0] == overtravel[1] and q[i] > upper and speed > 0.0:
            overtravel = q[i], upper
    v = tool.J_BT[:3] @ qd
    still = (
        _still(limits, servo, turned, 0),
        _still(limits, servo, turned, 1),
        _still(limits, servo, turned, 2),
        _still(limits, servo, turned, 3),
        _still(limits, servo, turned, 4),
        _still(limits, servo, turned, 5),
    )
    return norm(v), finite, leap, (behind, at_most), overtravel, outside(limits.workspace, tool.p_BT), still


def update_timers(
    settings: ScanSettings, timers: Timers, watch: PlantWatch, found: Readings, dt_s: float
) -> Timers:
    """``timers`` after a scan with the valves live."""
    limits, sensors = settings.supervision, watch.sensors
    if sensors is None:
        return timers
    enabled = sensors.status & STATUS_VALVES_ENABLED
    low = not sensors.status & STATUS_SUPPLY_ON or sensors.supply_bar < limits.supply_min_bar
    return Timers(
        timers.supply_low + dt_s if low else 0.0,
        0.0 if enabled else timers.not_enabled + dt_s,
        timers.overspeed + dt_s if found.speed > limits.overspeed else 0.0,
        _lasting(timers.stuck, found.still, dt_s) if any(found.still) else RESTED.stuck,
    )


def _lasting(stuck: tuple[float, ...], still: Sextet, dt_s: float) -> tuple[float, ...]:
    return tuple([t + dt_s if is_still else 0.0 for t, is_still in zip(stuck, still, strict=True)])


def first_fault(evidence: Evidence) -> Fault | None:
    """The gravest fault present, None when all is well; to be asked while the valves are live."""
    for row in FAULTS:
        if row.found is not None:
            found = row.found(evidence)
            if found is not None:
                return Fault(row.code, *found)
    return None


def _above(value: float, limit: float) -> ValueAndLimit | None:
    return (value, limit) if value > limit else None


def _overrun(e: Evidence) -> ValueAndLimit | None:
    return _above(e.dt_s, e.settings.supervision.overrun)


def _link_lost(e: Evidence) -> ValueAndLimit | None:
    return link_lost(e.settings, e.watch)


def _frozen(e: Evidence) -> ValueAndLimit | None:
    return cycle_frozen(e.settings, e.watch)


def _status(e: Evidence, bit: int) -> ValueAndLimit | None:
    sensors = e.watch.sensors
    return (float(sensors.status), 0.0) if sensors is not None and sensors.status & bit else None


def _tripped(e: Evidence) -> ValueAndLimit | None:
    return _status(e, STATUS_WATCHDOG_TRIPPED)


def _sensor_fault(e: Evidence) -> ValueAndLimit | None:
    return _status(e, STATUS_SENSOR_FAULT)


def _supply_low(e: Evidence) -> ValueAndLimit | None:
    limits, sensors = e.settings.supervision, e.watch.sensors
    if sensors is None or e.timers.supply_low <= limits.supply_low:
        return None
    return sensors.supply_bar * _PA_PER_BAR, limits.supply_min_bar * _PA_PER_BAR


def _not_enabled(e: Evidence) -> ValueAndLimit | None:
    return _above(e.timers.not_enabled, e.settings.supervision.valves_enable)


def _not_finite(e: Evidence) -> ValueAndLimit | None:
    return None if e.found.finite else (math.nan, 0.0)


def _jumped(e: Evidence) -> ValueAndLimit | None:
    return _above(e.found.leap, e.settings.supervision.encoder_jump)


def _stuck(e: Evidence) -> ValueAndLimit | None:
    return _above(max(e.timers.stuck), e.settings.supervision.encoder_stuck)


def _behind(e: Evidence) -> ValueAndLimit | None:
    return _above(*e.found.behind)


def _overtravel(e: Evidence) -> ValueAndLimit | None:
    value, limit = e.found.overtravel
    return None if value == limit else (value, limit)


def _overspeed(e: Evidence) -> ValueAndLimit | None:
    limits = e.settings.supervision
    return (e.found.speed, limits.overspeed) if e.timers.overspeed > limits.overspeed_time else None


def _leaves(e: Evidence) -> ValueAndLimit | None:
    value, limit = e.found.outside
    if value == limit:
        return None
    space = e.settings.supervision.workspace
    ahead, bound = outside(space, e.p_BT + _AHEAD_S * e.servo.v_desired)
    return (value, limit) if abs(ahead - bound) > abs(value - limit) else None


# The servo is trusted to ramp down before the valves are centred.
_RAMP = Reaction(Severity.STOP, Stimulus.FAULT_STOP)
# The arm was slowed down while it waited: its ramp is over.
_RAMPED = Reaction(Severity.STOP, Stimulus.FAULT_EMERGENCY)
# The valves are centred in the same scan.
_CENTRE = Reaction(Severity.EMERGENCY, Stimulus.FAULT_EMERGENCY)

# The gravest first.
FAULTS = (
    FaultRow(FaultCode.EMERGENCY_STOP, Reaction(Severity.EMERGENCY, Stimulus.EMERGENCY_STOP)),
    FaultRow(FaultCode.OVERRUN, _CENTRE, _overrun),
    FaultRow(FaultCode.PLANT_LINK_LOST, _CENTRE, _link_lost),
    FaultRow(FaultCode.PLANT_CYCLE_FROZEN, _CENTRE, _frozen),
    FaultRow(FaultCode.PLANT_WATCHDOG, _CENTRE, _tripped),
    FaultRow(FaultCode.PLANT_STATUS, _CENTRE, _sensor_fault),
    FaultRow(FaultCode.SUPPLY_PRESSURE_LOST, _CENTRE, _supply_low),
    FaultRow(FaultCode.PLANT_STATUS, _CENTRE, _not_enabled),
    FaultRow(FaultCode.NUMERIC, _CENTRE, _not_finite),
    FaultRow(FaultCode.ENCODER_JUMP, _CENTRE, _jumped),
    FaultRow(FaultCode.ENCODER_STUCK, _CENTRE, _stuck),
    FaultRow(FaultCode.FOLLOWING_ERROR, _CENTRE, _behind),
    FaultRow(FaultCode.JOINT_LIMIT, _RAMP, _overtravel),
    FaultRow(FaultCode.OVERSPEED, _CENTRE, _overspeed),
    FaultRow(FaultCode.WORKSPACE_LIMIT, _RAMP, _leaves),
    FaultRow(FaultCode.REFERENCE_LINK_LOST, _RAMP),
    FaultRow(FaultCode.REFERENCE_STALE, _RAMPED),
)
REACTIONS = {row.code: row.reaction for row in FAULTS}
