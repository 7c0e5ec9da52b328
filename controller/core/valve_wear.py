"""Whether valves still are what commissioning found: the spool that a joint's speed takes, against its own.

While a joint moves, its commissioned valve says which spool its speed takes. A valve that opens later, with a
wider hysteresis or less flow, takes more: the position loop gives it, at the price of an error that it needs
for that. A load that comes down on its load-holding valve is left out. Nothing here moves the arm.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.core.kinematics.rotations import Array
from controller.core.scan_types import ScanEvent, ScanState
from controller.core.servo.joint_control import opening_for
from controller.core.servo.servo_step import full_spool_speeds
from controller.core.settings import ScanSettings
from nominal_arm.description import JOINT_NAMES
from protocol.axes_group import Mode

WORN = "worn"
_PERIOD_S = 0.05  # [D] between samples
_LATE = 2  # [M] samples: a speed follows its spool by 0.1 s (mobile valves)
_SPAN = 4  # [D] samples: both are means over 0.2 s
_SLOWEST_RAD_S = 2e-3  # [D] 8 encoder digits in that time
_OPEN = 0.5  # [D] of the deadband: what moves behind a spool nearer to its centre is swung
_LEAST = 8  # [D] windows of 0.2 s
_SIGMAS = 2.0  # [D]
_LIMIT = 0.25  # [M] of the deadband: healthy edges -0.3 to 0.3, mostly below 0.1; worn ones 0.3 to 0.6


class SpoolSample(NamedTuple):
    """One sample of six joints: angles (rad) and spools behind their hysteresis."""

    q: Array
    spool: Array


class WearWatch(NamedTuple):
    """What was seen since the start. ``since_s``: last sample; ``spool`` (6,): behind the hysteresis that
    commissioning found; ``moving``: samples of the motion under way that no window has counted.

    ``sums`` (5, 6, 2), by joint, raising and lowering: windows; the spool beyond the valve's as a share of
    its deadband, and its square; the spool taken, and the valve's. ``named`` (6,): joints that were reported.
    """

    since_s: float
    spool: Array
    moving: tuple[SpoolSample, ...]
    sums: Array
    named: NDArray[np.bool_]


def empty_watch() -> WearWatch:
    """The watch before the first scan."""
    return WearWatch(0.0, np.zeros(6), (), np.zeros((5, 6, 2)), np.zeros(6, dtype=bool))


def watch_wear(
    settings: ScanSettings, watch: WearWatch, state: ScanState, dt_s: float
) -> tuple[WearWatch, tuple[ScanEvent, ...]]:
    """``watch`` after a scan that left ``state``, and an event for each joint whose valve has worn.

    An event is named ``worn``, its cause is the joint. Its value is how many times the commissioned valve's
    spool the joint takes, its limit from how many times on that is reported.
    """
    since_s = watch.since_s + dt_s
    if since_s < _PERIOD_S:
        return watch._replace(since_s=since_s), ()
    half = settings.servo.joints.half_play
    spool = np.clip(watch.spool, state.servo.valves - half, state.servo.valves + half)
    watch = watch._replace(since_s=0.0, spool=spool)
    if state.mode not in (Mode.MOVING, Mode.STREAMING):
        return watch._replace(moving=()), ()
    moving = (*watch.moving, SpoolSample(state.watch.q_meas, spool))
    if len(moving) <= _LATE + _SPAN:
        return watch._replace(moving=moving), ()
    watch = _counted(settings, watch._replace(moving=moving[_SPAN:]), moving, since_s)
    return _reported(settings, watch)


def _counted(
    settings: ScanSettings, watch: WearWatch, moving: tuple[SpoolSample, ...], period_s: float
) -> WearWatch:
    """``watch`` with the window that ``moving`` is."""
    servo, sums = settings.servo, watch.sums.copy()
    rate = (moving[-1].q - moving[_LATE].q) / (_SPAN * period_s)
    spool = np.mean([sample.spool for sample in moving[: _SPAN + 1]], axis=0)
    speeds = full_spool_speeds(servo.drives, moving[-1].q, servo.rated, servo.rated, np.zeros(6))
    for i in np.flatnonzero((rate * spool > 0.0) & (np.abs(rate) > _SLOWEST_RAD_S)):
        side = 0 if spool[i] > 0.0 else 1
        edge, taken = servo.joints.deadband[i, side], abs(spool[i])
        held = side == 1 and servo.joints.holding.damping[i] > 0.0  # its load-holding valve meters the oil
        if held or edge <= 0.0 or taken < _OPEN * edge:
            continue
        flow = abs(rate[i]) / (servo.joints.flow_gain[i, side] * speeds[i, side])
        said = edge + opening_for(servo.joints.curve[i, side], flow)
        beyond = (taken - said) / edge
        sums[:, i, side] += (1.0, beyond, beyond**2, taken, said)
    return watch._replace(sums=sums)


def _reported(settings: ScanSettings, watch: WearWatch) -> tuple[WearWatch, tuple[ScanEvent, ...]]:
    """``watch`` and an event for each joint that is named from now on."""
    events, named = [], watch.named.copy()
    for i, side in np.argwhere(watch.sums[0] >= _LEAST):
        count, beyond, squares, taken, said = watch.sums[:, i, side].tolist()
        mean = beyond / count
        variance = max(squares / count - mean**2, 0.0) / (count - 1.0)
        if named[i] or mean - _SIGMAS * math.sqrt(variance) <= _LIMIT:
            continue
        named[i] = True
        limit = 1.0 + _LIMIT * float(settings.servo.joints.deadband[i, side]) * count / said
        events.append(ScanEvent(WORN, JOINT_NAMES[i].upper(), taken / said, limit))
    return watch._replace(named=named), tuple(events)


def in_words(joint: str, times: float) -> str:
    """The sentence of a ``worn`` event for a person."""
    return (
        f"{joint.lower()} takes {times:.2f} times the spool that its commissioned valve says: "
        "the valve has worn, commission again"
    )
