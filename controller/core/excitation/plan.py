"""What is excited, in which order, and inside which limits; plain data."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from controller.config import ControllerConfig
from controller.core.kinematics.rotations import Array
from controller.core.trajectories.path_survey import JOINT_MARGIN_DEG
from nominal_arm.description import NominalArm

N_JOINTS = 6
_TRAVEL_DEG = (3.0, 3.0, 3.0, 5.0, 5.0, 5.0)  # [D] 0.2 m at the tool at 4 m
_TOP_SPEED_DEG_S = (2.5, 2.5, 2.5, 6.0, 6.0, 6.0)  # [D] a fifth of what is commanded in work
SEARCH_RATE_1_S = 0.03  # [D] of the spool: through the widest overlap in 6 s
RAMP_RATE_1_S = 0.01  # [D] slow against valve and oil, quick enough for 15 minutes in all
# Ramps begin this far below where the valve was seen to open, the first one three times as far.
START_BELOW = 0.01  # [D]
MOVED_RAD = 0.6e-3  # [D] counts as motion: twelve encoder digits
OTHERS_RAD = 30e-3  # [D] closed valves leak: with an empty tool the wrist sinks by 0.3 mrad/s [M]
REST_S = 0.4  # [D] between strokes, until the loaded boom has swung out
PATIENCE_S = 20.0  # [D] a boom that swings on by then does so by itself
STEP_S = 2.5  # [D] at most: more than two periods of the slowest swing
STROKE_S = 40.0  # [D] at most


class StrokeKind(IntEnum):
    """How the valve of one joint is opened: until it moves, by a slow triangle, or at once."""

    SEARCH = 0
    RAMP = 1
    STEP = 2


class Stroke(NamedTuple):
    """One excitation of one joint, at the end of which its valve is centred.

    ``outward``: away from where the joint stood at first, or back there. ``speed`` (rad/s): at the top of a
    ramp, or wanted of a step; 0 for a search. ``pace``: of a ramp, in units of the plan's rate.
    """

    joint: int
    kind: StrokeKind
    outward: bool
    speed: float
    pace: float = 1.0


class ExcitationLimits(NamedTuple):
    """What bounds every excitation; arrays are (6,), SI and radians, spools as shares of the full one.

    ``travel``: of one stroke. ``top_speed``: at the top of a ramp; ``speed_limit``, ``joint_range`` (2, 6):
    at which the excitation ends. ``spool_max``: of the full one. ``pressure_bar``: in any chamber.
    """

    travel: Array
    top_speed: Array
    speed_limit: Array
    joint_range: Array
    spool_max: float
    pressure_bar: float


class ExcitationPlan(NamedTuple):
    """Limits, and the strokes in order. No stroke: nothing is excited."""

    limits: ExcitationLimits
    strokes: tuple[Stroke, ...]


_FIRST_SHARE = 0.4  # [D] of the ramps' top speed
_PACES = (1.0, 2.0)  # [D]
_STEP_SHARES = (0.35, 0.7, 1.0)  # [D] of the ramp's top speed


def strokes_of(joints: tuple[int, ...], top_speed: Array, ramps: int) -> tuple[Stroke, ...]:
    """The strokes for ``joints``: a search, triangles and three steps, each out and back.

    A first, slow triangle shows how far the spool's hysteresis reaches; ``ramps`` full ones follow, every
    other one at twice the pace: what grows with the pace is lag, the rest of the loop is hysteresis.
    """
    found: list[Stroke] = []
    for joint in joints:
        speed = float(top_speed[joint])
        shapes = [(StrokeKind.SEARCH, 0.0, 1.0), (StrokeKind.RAMP, _FIRST_SHARE * speed, 1.0)]
        shapes += [(StrokeKind.RAMP, speed, _PACES[k % 2]) for k in range(ramps)]
        shapes += [(StrokeKind.STEP, share * speed, 1.0) for share in _STEP_SHARES]
        found += [Stroke(joint, kind, out, v, pace) for kind, v, pace in shapes for out in (True, False)]
    return tuple(found)


def excitation_plan(arm: NominalArm, config: ControllerConfig) -> ExcitationPlan | None:
    """What ``config`` says of trying out valves; None unless it is enabled."""
    chosen = config.excitation
    if not chosen.enabled:
        return None
    top_speed = np.radians(_TOP_SPEED_DEG_S)
    margin = JOINT_MARGIN_DEG
    limits = ExcitationLimits(
        travel=np.radians(_TRAVEL_DEG),
        top_speed=top_speed,
        speed_limit=np.radians([joint.speed_deg_s for joint in arm.joints]),
        joint_range=np.radians(
            [[j.lower_deg + margin for j in arm.joints], [j.upper_deg - margin for j in arm.joints]]
        ),
        spool_max=chosen.spool_max,
        pressure_bar=chosen.pressure_bar,
    )
    return ExcitationPlan(limits, strokes_of(chosen.joints, top_speed, chosen.ramps))


SWING_RAD_S = 4.0e-3  # [D] a reversal counts from this speed on either side


class Phase(IntEnum):
    """What the excitation does now."""

    RESTING = 0
    RISING = 1
    TURNING = 2
    FALLING = 3
    HOLDING = 4
    ENDED = 5
    RETURNING = 6


class Failure(NamedTuple):
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
