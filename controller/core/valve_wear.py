"""Whether valves still are what commissioning found: the spool that a joint's speed takes, against its own.

While a joint moves, its commissioned valve says which spool its speed takes. A valve that opens later, with a
wider hysteresis or less flow, takes more: the position loop gives it, at the price of an error that it needs
for that. Nothing here moves the arm.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.scan_types import ScanEvent, ScanState
from controller.core.servo.joint_control import opening_for
from controller.core.servo.servo_step import full_spool_speeds
from controller.core.settings import ScanSettings
from nominal_arm.description import JOINT_NAMES
from protocol.axes_group import Mode

WORN = "worn"
_PERIOD_S = 0.05  # [D] between samples
_LATE, _SPAN = (
    2,
    4,
)  # [M] samples: a speed follows its spool by 0.1 s (mobile valves); both are means over 0.2 s
_SLOWEST_RAD_S = 2e-3  # [D] 8 encoder digits in that time
_OPEN = 0.5  # [D] of the deadband: what moves behind a spool nearer to its centre is swung
_LEAST = 8  # [D] windows of 0.2 s
_SIGMAS = 2.0  # [D]
# [M] of the deadband. Edges of three healthy machines showed -0.3 to 0.3 of it, mostly under 0.1; those worn
# by a tenth 0.1 to 0.25, by three tenths 0.3 to 0.6
_LIMIT = 0.25


class Seen(NamedTuple):
    """One sample of six joints: angles (rad) and spools behind their hysteresis."""

    q: Array
    spool: Array


class WearWatch(NamedTuple):
    """What was seen since the start. ``since_s``: the last sample; ``spool`` (6,): behind the hysteresis that
    commissioning found; ``moving``: samples of the motion under way that no window has counted.

    Per joint, raising and lowering (6, 2): ``windows``; sums of the spool in ``excess`` of the valve's, as
    a share of its deadband, of its ``squares``, of the spool ``taken`` and of what the valve ``said``;
    ``named``: those that were reported.
    """

    since_s: float
    spool: Array
    moving: tuple[Seen, ...]
    windows: Array
    excess: Array
    squares: Array
    taken: Array
    said: Array
    named: Array


def watch_begun() -> WearWatch:
    """The watch before the first scan."""
    sums = [np.zeros((6, 2)) for _ in range(5)]
    return WearWatch(0.0, np.zeros(6), (), *sums, np.zeros((6, 2), dtype=bool))


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
    moving = (*watch.moving, Seen(state.watch.q_meas, spool))
    if len(moving) <= _LATE + _SPAN:
        return watch._replace(moving=moving), ()
    watch = _counted(settings, watch._replace(moving=moving[_SPAN:]), moving, since_s)
    return _reported(settings, watch)


def _counted(
    settings: ScanSettings, watch: WearWatch, moving: tuple[Seen, ...], period_s: float
) -> WearWatch:
    """``watch`` with the window that ``moving`` is."""
    joints, drives = settings.servo.joints, settings.servo
    rate = (moving[-1].q - moving[_LATE].q) / (_SPAN * period_s)
    spool = np.mean([seen.spool for seen in moving[: _SPAN + 1]], axis=0)
    speeds = full_spool_speeds(drives.drives, moving[-1].q, drives.rated, drives.rated, np.zeros(6))
    sums = [s.copy() for s in (watch.windows, watch.excess, watch.squares, watch.taken, watch.said)]
    for i in np.flatnonzero((rate * spool > 0.0) & (np.abs(rate) > _SLOWEST_RAD_S)):
        side = 0 if spool[i] > 0.0 else 1
        edge, taken = joints.deadband[i, side], abs(spool[i])
        if edge <= 0.0 or taken < _OPEN * edge:
            continue
        flow = abs(rate[i]) / (joints.flow_gain[i, side] * speeds[i, side])
        said = edge + opening_for(joints.curve[i, side], flow)
        share = (taken - said) / edge
        for total, value in zip(sums, (1.0, share, share**2, taken, said), strict=True):
            total[i, side] += value
    return watch._replace(**dict(zip(("windows", "excess", "squares", "taken", "said"), sums, strict=True)))


def _reported(settings: ScanSettings, watch: WearWatch) -> tuple[WearWatch, tuple[ScanEvent, ...]]:
    events, named = [], watch.named.copy()
    for i, side in np.argwhere((watch.windows >= _LEAST) & ~watch.named.any(axis=1, keepdims=True)):
        count = float(watch.windows[i, side])
        mean = float(watch.excess[i, side]) / count
        variance = max(float(watch.squares[i, side]) / count - mean**2, 0.0) / (count - 1.0)
        if mean - _SIGMAS * math.sqrt(variance) <= _LIMIT:
            continue
        named[i, side] = True
        said = float(watch.said[i, side])
        limit = 1.0 + _LIMIT * settings.servo.joints.deadband[i, side] * count / said
        events.append(
            ScanEvent(WORN, JOINT_NAMES[i].upper(), float(watch.taken[i, side]) / said, float(limit))
        )
    return watch._replace(named=named), tuple(events)


def in_words(joint: str, times: float) -> str:
    """What a person is told of a ``worn`` event."""
    return (
        f"{joint.lower()} takes {times:.2f} times the spool that its commissioned valve says: "
        "the valve has worn, commission again"
    )
