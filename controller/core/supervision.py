"""Faults: what the controller watches while it drives the valves, and how it reacts to each.

Source: the fault cases of a safe reference link: ramp down or centre the valves, drop the enable, latch
the first cause.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.plant_watch import PlantWatch, cycle_frozen, link_lost
from controller.core.settings import ScanSettings
from controller.core.trajectories.path_survey import outside
from protocol.faults import FaultCode, Severity
from protocol.process_image import (
    STATUS_SENSOR_FAULT,
    STATUS_SUPPLY_ON,
    STATUS_VALVES_ENABLED,
    STATUS_WATCHDOG_TRIPPED,
)

# STOP: the servo is trusted to ramp down before the valves are centred. All others: centred in the same scan.
SEVERITY = dict.fromkeys(FaultCode, Severity.EMERGENCY) | {
    FaultCode.NONE: Severity.NONE,
    FaultCode.REFERENCE_LINK_LOST: Severity.STOP,
    FaultCode.JOINT_LIMIT: Severity.STOP,
    FaultCode.WORKSPACE_LIMIT: Severity.STOP,
    FaultCode.REFERENCE_STALE: Severity.STOP,
}


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
    """What the servo did in the last scan; supervision judges the plant's answer against it."""

    q_cmd: Array
    qd_cmd: Array
    valves: Array
    v_desired: Array


def plant_ready(settings: ScanSettings, watch: PlantWatch) -> bool:
    """Whether the plant may be enabled: supply on, no sensor fault, no tripped watchdog."""
    if watch.sensors is None:
        return False
    status = watch.sensors.status
    return bool(
        status & STATUS_SUPPLY_ON
        and not status & (STATUS_SENSOR_FAULT | STATUS_WATCHDOG_TRIPPED)
        and watch.sensors.supply_bar >= settings.config.supervision.supply_min_bar
    )


def update_timers(
    settings: ScanSettings, timers: Timers, watch: PlantWatch, servo: ServoOutput, speed: float, dt_s: float
) -> Timers:
    """``timers`` after a scan with the valves live; ``speed`` is the tool's (m/s)."""
    limits, sensors = settings.config.supervision, watch.sensors
    if sensors is None:
        return timers
    enabled = sensors.status & STATUS_VALVES_ENABLED
    low = not sensors.status & STATUS_SUPPLY_ON or sensors.supply_bar < limits.supply_min_bar
    still = (watch.turned == 0.0) & (np.abs(servo.valves) > limits.encoder_stuck_valve)
    return Timers(
        timers.supply_low + dt_s if low else 0.0,
        0.0 if enabled else timers.not_enabled + dt_s,
        timers.overspeed + dt_s if speed > limits.overspeed_m_s else 0.0,
        tuple(
            stuck + dt_s if is_still else 0.0
            for stuck, is_still in zip(timers.stuck, still.tolist(), strict=True)
        ),
    )


def first_fault(
    settings: ScanSettings,
    watch: PlantWatch,
    timers: Timers,
    servo: ServoOutput,
    p_BT: Array,
    speed: float,
    dt_s: float,
) -> Fault | None:
    """The gravest fault present, None when all is well; to be asked while the valves are live."""
    return (
        _of_links(settings, watch, dt_s)
        or _of_plant(settings, watch, timers)
        or _of_joints(settings, watch, timers, servo)
        or _of_tool(settings, timers, servo, p_BT, speed)
    )


def _of_links(settings: ScanSettings, watch: PlantWatch, dt_s: float) -> Fault | None:
    limit = settings.config.supervision.overrun_ms * 1e-3
    if dt_s > limit:
        return Fault(FaultCode.OVERRUN, dt_s, limit)
    lost = link_lost(settings, watch)
    if lost is not None:
        return Fault(FaultCode.PLANT_LINK_LOST, *lost)
    frozen = cycle_frozen(settings, watch)
    return None if frozen is None else Fault(FaultCode.PLANT_CYCLE_FROZEN, *frozen)


def _of_plant(settings: ScanSettings, watch: PlantWatch, timers: Timers) -> Fault | None:
    limits, sensors = settings.config.supervision, watch.sensors
    if sensors is None:
        return None
    if sensors.status & STATUS_WATCHDOG_TRIPPED:
        return Fault(FaultCode.PLANT_WATCHDOG, float(sensors.status), 0.0)
    if sensors.status & STATUS_SENSOR_FAULT:
        return Fault(FaultCode.PLANT_STATUS, float(sensors.status), 0.0)
    if timers.supply_low * 1e3 > limits.supply_low_ms:
        return Fault(FaultCode.SUPPLY_PRESSURE_LOST, sensors.supply_bar * 1e5, limits.supply_min_bar * 1e5)
    if timers.not_enabled * 1e3 > limits.valves_enable_ms:
        return Fault(FaultCode.PLANT_STATUS, timers.not_enabled, limits.valves_enable_ms * 1e-3)
    return None


def _of_joints(settings: ScanSettings, watch: PlantWatch, timers: Timers, servo: ServoOutput) -> Fault | None:
    limits = settings.config.supervision
    if not (np.isfinite(servo.q_cmd).all() and np.isfinite(servo.valves).all()):
        return Fault(FaultCode.NUMERIC, math.nan, 0.0)
    jump, most = float(np.abs(watch.turned).max()), math.radians(limits.encoder_jump_deg)
    if jump > most:
        return Fault(FaultCode.ENCODER_JUMP, jump, most)
    if max(timers.stuck) * 1e3 > limits.encoder_stuck_ms:
        return Fault(FaultCode.ENCODER_STUCK, max(timers.stuck), limits.encoder_stuck_ms * 1e-3)
    behind = np.abs(servo.q_cmd - watch.q_meas)
    worst = int((behind / settings.following_error).argmax())
    if behind[worst] > settings.following_error[worst]:
        return Fault(FaultCode.FOLLOWING_ERROR, float(behind[worst]), float(settings.following_error[worst]))
    over = math.radians(limits.joint_overtravel_deg)
    lower, upper = settings.joint_range[0] - over, settings.joint_range[1] + over
    outward = ((watch.q_meas < lower) & (servo.qd_cmd < 0.0)) | (
        (watch.q_meas > upper) & (servo.qd_cmd > 0.0)
    )
    if outward.any():
        i = int(outward.argmax())
        limit = lower[i] if watch.q_meas[i] < lower[i] else upper[i]
        return Fault(FaultCode.JOINT_LIMIT, float(watch.q_meas[i]), float(limit))
    return None


def _of_tool(
    settings: ScanSettings, timers: Timers, servo: ServoOutput, p_BT: Array, speed: float
) -> Fault | None:
    limits = settings.config.supervision
    if timers.overspeed * 1e3 > limits.overspeed_ms:
        return Fault(FaultCode.OVERSPEED, speed, limits.overspeed_m_s)
    margin = limits.workspace_margin_m
    wide = settings.workspace + margin * np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    value, limit = outside(wide, p_BT)
    if value != limit:
        ahead, bound = outside(wide, p_BT + 0.1 * servo.v_desired)
        if abs(ahead - bound) > abs(value - limit):  # a tool that stands outside may come back
            return Fault(FaultCode.WORKSPACE_LIMIT, value, limit)
    return None
