"""What parking keeps of each joint from scan to scan, and the constants of its laws."""

from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array

# Rows of the state (STATE_ROWS, 6), a column for each joint.
# PHASE: FOLLOWING the joint law, SHUT, OPEN (an inch), NUDGED, or KEPT; SINCE: how long (s). SPEED: of the
# joint, filtered (rad/s); ERROR: filtered (rad); HELD: how long the following joint has been inside its
# band (s), or since when it follows no more; BAND: that (rad). PARKED: 1 once the joint rests, 2 once the
# whole arm does; PLACE: error where the joint rested then (rad), 0 before. CALM: how long it has been near
# CALM_AT (rad). QUIET: how long CREPT has been about QUIET_AT (rad), and LOAD about RESTED (bar). Of the
# last inch or nudge, SENSE: ±1; OPENED: spool, without its sign; FROM, LOAD_AT: error (rad) and load (bar)
# at which it began; SEEN: 1 once the joint moved in it; FINE: 1 when it is shorter than can be watched
# well; HASTE: how many in a row were due too soon. Of the shut joint, SHUT_AT: error when it had come to
# rest (rad); DRIFT: its creep, as a rate of the error (rad/s); CREPT: error, filtered for seconds (rad);
# MARK: that at the last nudge, AFTER: time since (s). BIAS: of the kept joint, its leak in terms of speed
# (rad/s); OWED: what rounding has kept from its valve (spool); FELT: its load, filtered for long (bar);
# SINCE: how long it has been too high (s); MARK: error when its valve was shut for that (rad). Learned,
# raising and lowering: EDGE, the spool at which the joint moves; DOUBT, how far before it an inch begins;
# NUDGE, where a nudge begins (spool), 0 before the first; PUSH, its end by the load pressure (bar). LOAD:
# the load pressure, filtered for seconds (bar). Of a metered joint, OIL: error less what its oil is
# compressed by (rad), which changes by what flows alone; OIL_AT: that when the joint had been shut,
# OIL_FROM: when its inch began; RATE: of the oil through an open valve, of the error of a shut joint
# (rad/s); WAY: that the last inch was for (rad), 0 before the first; GIVES: how many times as much oil it
# had; OPENING: how long its valve was open (s), 0 once that has been learned from. CAME: the sense, ±1, in
# which the joint turned last by its encoder, or was told to, 0 before; FURTHEST: how far that went; WENT: the
# encoder, filtered (rad). EASE: what the oil of a metered joint is compressed by once friction has let go
# of it (rad); EASE_AT: the encoder where that was seen last (rad). DRAGS: for how long a parked joint has
# dragged its encoder along since its last nudge (s). STEADY: for how long the BIAS of a kept joint has been
# about STEADY_AT (rad/s).
PHASE, SINCE, SPEED, ERROR, HELD, BAND, PARKED, PLACE, QUIET, QUIET_AT = range(10)
SENSE, OPENED, FROM, SEEN, FINE, HASTE, SHUT_AT, DRIFT = range(10, 18)
MARK, AFTER, BIAS, LOAD_AT, CREPT, OWED, FELT = range(18, 25)
LOAD, RESTED, RATE, OIL, OIL_FROM, OIL_AT, WAY, GIVES, OPENING = range(25, 34)
CALM, CALM_AT, CAME, FURTHEST, WENT, EASE, EASE_AT, DRAGS, STEADY, STEADY_AT = range(34, 44)
EDGE, DOUBT, NUDGE, PUSH, STATE_ROWS = 44, 46, 48, 50, 52

_EARLY = 0.1  # of its deadband, before its edge: there a metered inch begins, however well that is known

FOLLOWING, SHUT, OPEN, KEPT, NUDGED = 0.0, 1.0, 2.0, 3.0, 4.0


class ParkingLaw(NamedTuple):
    """Constants of parking; arrays are (6,) or (6, 2): raising and lowering.

    ``band`` (m, of the tool at the joint's lever) between ``band_least`` and ``band_most`` (rad): error at
    which a shut joint begins an inch. ``slowest``, ``fastest``: of an inch (rad/s). ``patience`` (s): time
    that the joint law has to arrive. ``calm_way`` (m), ``calm`` (s): a joint rests that moved the tool by no
    more for so long, and is brought back when it is ``leaves`` (rad) off. ``stays`` (s): after a motion, an
    arm that does not come to rest counts as resting. ``quiet`` (m): a joint rests that moves the tool by no
    more in 10 s. ``deadband``, ``spread``: what is known of it when it opens (spool). ``latest`` (s): from a
    command until motion is seen; ``shutting`` (s): how long a joint moves on when its valve is told to shut;
    ``loaded``: 1 where gravity makes a joint creep, 0 where parked it only relaxes. ``rest`` (6,), s: a joint
    that leaks through twice its band in less is kept by an opening. ``keeping`` (6,), 1/s: gain of that.
    ``exact`` (6,): 1 for a valve that passes a small flow steadily. ``felt`` (6,), rad/bar: how far a kept
    joint has moved when friction, a spring before it slides, has changed the load pressure; 0: not used.
    ``oil`` (6,), rad/bar: how far a joint moves with its valve shut as the load pressure falls; 0: its inches
    are not metered. ``play`` (6,), rad: how far beyond its place a joint is left that would have to go
    through its play to come back; 0: not known. ``highest``: spool beyond which a valve is open, surely.
    ``dt_s``: of a scan.
    """

    band: float
    band_least: float
    band_most: float
    slowest: float
    fastest: float
    patience: float
    calm_way: float
    calm: float
    leaves: float
    stays: float
    quiet: float
    deadband: Array
    spread: Array
    latest: Array
    shutting: Array
    loaded: Array
    rest: Array
    keeping: Array
    exact: Array
    felt: Array
    oil: Array
    play: Array
    highest: Array
    dt_s: float


def parking_begun(law: ParkingLaw | None) -> Array:
    """The state (STATE_ROWS, 6) before the first inch: every valve as it is known."""
    state = np.zeros((STATE_ROWS, 6))
    if law is not None:
        state[EDGE : EDGE + 2] = law.deadband.T
        early = np.where(law.oil > 0.0, _EARLY * law.deadband.T, 0.0)
        state[DOUBT : DOUBT + 2], state[GIVES] = np.maximum(law.spread.T, early), 1.0
    return state


def parking_ended(state: Array) -> Array:
    """``state`` when a motion begins: the joint law drives all joints; what was learned is kept."""
    follows = state.copy()
    follows[PHASE] = FOLLOWING
    follows[
        [SINCE, HELD, PARKED, PLACE, HASTE, DRIFT, QUIET, CALM, BIAS, MARK, AFTER, WAY, OPENING, STEADY]
    ] = 0.0
    follows[GIVES] = 1.0
    return follows


def off_place(state: Array) -> Array:
    """How far (rad) each joint (6,) is off its place, by its filtered encoder."""
    return np.asarray(state[ERROR] - state[PLACE])
