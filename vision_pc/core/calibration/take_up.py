"""Motions that always end alike: by short turns of slew, lift and tilt in their positive sense.

A joint stops anywhere inside the band that its valve's dead zone leaves, and backlash lets the tool stand to
either side of its encoder. Both are the same at every end if the joint always comes to rest from the same
side (as a machinist approaches a dimension).
"""

from typing import NamedTuple

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.boom_levers import boom_levers, joint_turns
from vision_pc.core.ports import Arm, ArmView
from vision_pc.core.se3 import Array, transform


class MotionEnd(NamedTuple):
    """How a motion ended: the last view, and the ``residual`` (3,) rad of slew, lift and tilt: measured
    beyond the reference.
    """

    view: ArmView
    residual: Array


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


async def move_with_take_up(
    arm: Arm, waypoints: list[Array], dimensions: BoomDimensions, settings: LocalErrorModelSettings
) -> MotionEnd:
    """Follow a path through ``waypoints`` (n, 4, 4); the last is reached by the take-up.

    Errors of the arm pass through.
    """
    *on_the_way, end = waypoints
    take_up = settings.take_up
    turns = np.array([take_up.slew_rad, take_up.boom_rad, take_up.boom_rad])
    before = transform(end[:3, :3], end[:3, 3] - boom_levers(end, dimensions) @ turns)
    await arm.follow([*on_the_way, before], segment_s=settings.segment_s, dwell_s=settings.dwell_s)
    view = await arm.move_to(end, duration_s=take_up.duration_s)
    return MotionEnd(view, joint_turns(end, view.X_BT, dimensions))
