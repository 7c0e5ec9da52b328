"""Where an excitation stands: what its strokes keep from scan to scan, and what is read off it."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from controller.core.excitation.plan import N_JOINTS, ExcitationPlan, Stroke
from controller.core.kinematics.rotations import Array

SWING_RAD_S = 4.0e-3  # a reversal counts from this speed on either side


class Phase(IntEnum):
    """What the excitation does now."""

    RESTING = 0
    RISING = 1
    TURNING = 2
    FALLING = 3
    HOLDING = 4
    ENDED = 5
    RETURNING = 6


class Trouble(NamedTuple):
    """Why an excitation was broken off: cause (``commissioning.…``), joint, value and limit (SI, bar)."""

    cause: str
    joint: int
    value: float
    limit: float


class Measured(NamedTuple):
    """What one scan measures: ``q`` (6,), and the greatest pressure in any chamber."""

    q: Array
    pressure_bar: float


class Excitation(NamedTuple):
    """Where the excitation stands. ``stroke``: index into the settings' strokes.

    ``spool``: of the stroke's joint, signed. ``q_start`` (6,): where the stroke began. ``home``, ``away``:
    where the joint stood before its first stroke, and the sense in which it has room. ``rim`` (6, 2): the
    spool's size at which the valve begins to pass oil, raising and lowering, as far as seen; 0 before.
    ``slope`` (6, 2), rad/s: speed over spool beyond that, 0 before.
    ``slack`` (6,): by how much the command surely turns back without an answer. ``top_speed``, ``top``: of
    the running ramp (or of a step so far), and its spool's size there; ``low_speed``, ``low``: likewise where
    it had begun to move.
    ``place`` (6,): where the arm stood at first; ``creep`` (6,), rad/s: before the stroke; ``returning``: the
    joint that is brought back to its place, None otherwise: then ``spool`` is its valve's. ``drift`` (6,),
    rad/s: the speed without what swings.
    """

    stroke: int
    phase: Phase
    phase_s: float
    stroke_s: float
    still_s: float
    spool: float
    speed: Array
    q_before: Array
    q_start: Array
    home: float
    away: float
    rim: Array
    slope: Array
    slack: Array
    top_speed: float
    top: float
    low_speed: float
    low: float
    swing: float
    reversals: int
    place: Array
    creep: Array
    returning: int | None
    drift: Array


def begun(q: Array, stroke: int = 0) -> Excitation:
    """An excitation that begins with ``stroke``, the arm at ``q`` (6,)."""
    zero = np.zeros(N_JOINTS)
    return Excitation(
        stroke=stroke,
        phase=Phase.RESTING,
        phase_s=0.0,
        stroke_s=0.0,
        still_s=0.0,
        spool=0.0,
        speed=zero,
        q_before=q,
        q_start=q,
        home=0.0,
        away=1.0,
        rim=np.zeros((N_JOINTS, 2)),
        slope=np.zeros((N_JOINTS, 2)),
        slack=zero,
        top_speed=0.0,
        top=0.0,
        low_speed=0.0,
        low=0.0,
        swing=0.0,
        reversals=0,
        place=q,
        creep=zero,
        returning=None,
        drift=zero,
    )


def driven(settings: ExcitationPlan, state: Excitation) -> int:
    """The joint whose valve ``spool`` is; every other valve is centred."""
    return settings.strokes[state.stroke].joint if state.returning is None else state.returning


def sense_of(state: Excitation, stroke: Stroke) -> float:
    """The sign of the spool in ``stroke``."""
    return state.away if stroke.outward else -state.away


def turned_by(state: Excitation, stroke: Stroke, q: Array) -> float:
    """How far (rad) the stroke has turned its joint the way that it wants, at ``q`` (6,)."""
    return sense_of(state, stroke) * float(q[stroke.joint] - state.q_start[stroke.joint])
