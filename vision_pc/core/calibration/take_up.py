"""Motions that always end alike: by short turns of slew, lift and tilt in one sense.

A joint stops anywhere inside the band that its valve's dead zone leaves, and backlash lets the tool stand to
either side of its encoder. Both are the same at every end if the joint always comes to rest from the same
side (as a machinist approaches a dimension). How far it must first be turned back depends on the machine:
the encoders show whether it went. Where it did not, it is turned back farther, now and in later motions.
"""

import math
from typing import NamedTuple

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.arm_fields import boom_levers, joint_turns
from vision_pc.core.ports import Arm, ArmView
from vision_pc.core.se3 import Array, transform


def slew_lever(X_BT: Array) -> Array:
    """Displacement (3,) of the TCP at ``X_BT`` in B for each radian of slew, m/rad."""
    return np.array([-X_BT[1, 3], X_BT[0, 3], 0.0])


def slew_angles(X_BT: Array, wrist_to_tool_m: float) -> Array:
    """Slew angles (N,) rad of poses (N, 4, 4): the wrist's centre lies on the slew plane."""
    wrist = X_BT[:, :3, 3] - wrist_to_tool_m * X_BT[:, :3, 2]
    return np.asarray(np.unwrap(np.arctan2(wrist[:, 1], wrist[:, 0])))


def backlash_sides(slew: Array, reversal: float) -> Array:
    """h (N,) in −1…1: the side of the backlash on which the slew's load lies; −1 after a positive turn.

    On a reversal the load crosses the whole backlash before the encoder turns back. An encoder that turns
    back by 2 ``reversal`` (rad) has changed sides: less may be noise.
    """
    states = np.zeros(len(slew))
    for i in range(1, len(slew)):
        turn = float(slew[i] - slew[i - 1])
        states[i] = min(max(float(states[i - 1]) - turn / reversal, -1.0), 1.0)
    return states


_WENT = 0.5  # of a turn back that the encoders must show
_TOO_FAR = 2.0  # residuals beyond its end a joint is turned back: the servo leaves one within its backlash
_SLOWEST = 6.0  # times the time of the usual turn: a longer one is faster after all
_ALIKE = 0.9  # of what it was beyond or short the last time: it comes no nearer
_BOOM = slice(0, 3)  # slew, lift, tilt


class TakeUp(NamedTuple):
    """How a motion ends: turns (3,) rad of slew, lift and tilt, in their positive sense where positive.

    ``gaps`` (3,) rad: the greatest distance between commanded and measured angle that was seen at rest, which
    is at most the band in which the joint's valve does not answer. ``swings`` (3,) rad: the farthest that it
    went to and fro by its encoder where it should have rested.
    """

    turns: Array
    gaps: Array
    swings: Array

    def swing_m(self, X_BT: Array, dimensions: BoomDimensions) -> float:
        """How far the tool at the pose (4, 4) goes to and fro by the joints' swings, m."""
        return float(np.linalg.norm(boom_levers(X_BT, dimensions) * self.swings))


def first_take_up(settings: LocalErrorModelSettings) -> TakeUp:
    """What is done before anything was seen of the machine."""
    boom = settings.take_up.boom_rad
    return TakeUp(np.array([settings.take_up.slew_rad, boom, boom]), np.zeros(3), np.zeros(3))


class MotionEnd(NamedTuple):
    """How a motion ended: the last view, the take-up that it needed, and the ``residual`` (3,) rad of slew,
    lift and tilt: measured beyond the reference.
    """

    view: ArmView
    take_up: TakeUp
    residual: Array


def widened_by_sight(
    take_up: TakeUp, residual: Array, X_BT: Array, settings: LocalErrorModelSettings
) -> TakeUp:
    """``take_up`` after a motion that by odometry ended ``residual`` (3,) m in B off its goal, at ``X_BT``.

    Steel that is loose beyond the slew's encoder stands on either side of its clearance. A turn that is
    shorter does not take it up: the tool goes too far then, whichever way it is corrected.
    """
    lever = slew_lever(X_BT)
    loose = settings.take_up.bands * abs(float(lever @ residual)) / float(lever @ lever)
    turns = take_up.turns.copy()
    turns[0] = math.copysign(min(max(abs(turns[0]), loose), settings.take_up.most_rad), turns[0])
    return take_up._replace(turns=turns)


async def move_with_take_up(
    arm: Arm,
    waypoints: list[Array],
    take_up: TakeUp,
    dimensions: BoomDimensions,
    settings: LocalErrorModelSettings,
) -> MotionEnd:
    """Follow a path through ``waypoints`` (n, 4, 4); the last is reached by the take-up.

    Errors of the arm pass through.
    """
    *on_the_way, end = waypoints
    limits = settings.take_up
    take_up = _with_seen_gaps(take_up, (await arm.view()), settings)
    before = _pose_before_take_up(end, take_up.turns, dimensions)
    view = await arm.follow([*on_the_way, before], segment_s=settings.segment_s, dwell_s=settings.dwell_s)
    residual, beyond_before = np.zeros(3), math.inf
    for again in reversed(range(limits.repeats + 1)):
        view, take_up = await _turned_back(arm, view, end, take_up, dimensions, settings)
        pace = float(np.abs(take_up.turns).max()) / max(limits.slew_rad, 1e-6)
        # no faster for being longer: loose steel would go on to the other side
        view = await arm.move_to(end, duration_s=limits.duration_s * min(max(pace, 1.0), _SLOWEST))
        take_up = _with_seen_gaps(take_up, view, settings)
        view, residual = await _wait_for_servo(arm, view, end, take_up, dimensions, settings)
        beyond = float((np.sign(take_up.turns) * residual).max())
        # one that comes as far each time is left there: further motions expect it
        if beyond <= _TOO_FAR * limits.residual_rad or beyond > _ALIKE * beyond_before or not again:
            break
        beyond_before = beyond
        view = await arm.move_to(_pose_before_take_up(end, take_up.turns, dimensions))
    return MotionEnd(view, take_up, residual)


async def _wait_for_servo(
    arm: Arm,
    view: ArmView,
    end: Array,
    take_up: TakeUp,
    dimensions: BoomDimensions,
    settings: LocalErrorModelSettings,
) -> tuple[ArmView, Array]:
    """The view at ``end`` and the residual (3,), after the servo's integral had time for a joint that is
    short of it. One that came too far is not sent back: that would take it through its backlash.
    """
    residual = joint_turns(end, view.X_BT, dimensions)
    for _ in range(settings.take_up.repeats):
        if (np.sign(take_up.turns) * residual).min() >= -settings.take_up.residual_rad:
            break
        view = await arm.move_to(end)
        residual, before = joint_turns(end, view.X_BT, dimensions), residual
        if np.abs(residual).max() > _ALIKE * np.abs(before).max():
            break
    return view, residual


async def _turned_back(
    arm: Arm,
    view: ArmView,
    end: Array,
    take_up: TakeUp,
    dimensions: BoomDimensions,
    settings: LocalErrorModelSettings,
) -> tuple[ArmView, TakeUp]:
    """The view once slew, lift and tilt have gone back by half of their turn at least, or will not."""
    most = settings.take_up.most_rad
    for _ in range(settings.take_up.repeats):
        back = -joint_turns(end, view.X_BT, dimensions) * np.sign(take_up.turns)
        stuck = back < _WENT * np.abs(take_up.turns)
        take_up = _with_seen_gaps(take_up, view, settings)
        if not stuck.any() or np.abs(take_up.turns).max() >= most:
            break
        wider = np.where(stuck, 2.0, 1.0) * take_up.turns
        take_up = take_up._replace(turns=np.clip(wider, -most, most))
        view = await arm.move_to(_pose_before_take_up(end, take_up.turns, dimensions))
    return view, take_up


def _pose_before_take_up(end: Array, turns: Array, dimensions: BoomDimensions) -> Array:
    """The pose from which ``turns`` (3,) end at ``end``; the tool's axes are held."""
    return transform(end[:3, :3], end[:3, 3] - boom_levers(end, dimensions) @ turns)


def _with_seen_gaps(take_up: TakeUp, view: ArmView, settings: LocalErrorModelSettings) -> TakeUp:
    """Turns that cross the band from one side to the other, as far as it was seen."""
    limits = settings.take_up
    gaps = np.maximum(take_up.gaps, np.abs(view.q_cmd - view.q_meas)[_BOOM])
    across = np.where(gaps > limits.gap_rad, limits.bands * gaps, 0.0)
    sizes = np.minimum(np.maximum(np.abs(take_up.turns), across), limits.most_rad)
    sense = np.where(take_up.turns < 0.0, -1.0, 1.0)
    return TakeUp(sense * sizes, gaps, np.maximum(take_up.swings, view.unrest[_BOOM]))
