"""Nominal joint speed at full spool: rotary actuators directly, cylinders through their triangle linkage."""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel
from nominal_arm.description import CylinderDrive, Drive, RatedSupply

# A cylinder's lever arm vanishes at the ends of a linkage; below this the map is held constant.
_LEVER_MIN_M = 0.05
# The least share of the rated pressure that counts as available: a stalled drive still has a finite gain.
_AVAILABLE_MIN = 0.1


# Columns of the drive table. A cylinder's two sides of its triangle (m; LONG 0: a rotary actuator), the joint
# angle's offset (rad), speeds at full spool (m/s, rad/s), ratio of the areas, chamber b to a.
LONG, SHORT, OFFSET, EXTEND, RETRACT, RATIO = range(6)


class Circuit(NamedTuple):
    """Pressures of supply and return (bar)."""

    supply: float
    back: float


def drive_table(drives: tuple[Drive, ...]) -> Array:
    """The table (6, 6) of the arm's drives, columns LONG … RATIO."""
    return np.array(
        [
            [d.long_m, d.short_m, d.angle_offset_rad, d.extend_m_s, d.retract_m_s, d.area_ratio]
            if isinstance(d, CylinderDrive)
            else [0.0, 0.0, 0.0, d.speed_rad_s, d.speed_rad_s, 1.0]
            for d in drives
        ]
    )


def rated_circuit(rated: RatedSupply) -> Circuit:
    """The circuit at which the drives' speeds hold, without a load."""
    return Circuit(rated.supply_bar, rated.return_bar)


def load_pressures(drives: Array, pressures_bar: tuple[tuple[float, float], ...]) -> Array:
    """What the loads put on the actuators (6,), bar, referred to chamber a: p_a − ratio · p_b."""
    chambers = np.array(pressures_bar)
    load: Array = chambers[:, 0] - drives[:, RATIO] * chambers[:, 1]
    return load


def pilot_pressures(drives: Array, pressures_bar: tuple[tuple[float, float], ...]) -> Array:
    """The pressures (6,), bar, of the chambers b, referred to chamber a: ratio · p_b."""
    pilot: Array = drives[:, RATIO] * np.array(pressures_bar)[:, 1]
    return pilot


@kernel
def full_spool_speeds(drives: Array, q: Array, rated: Circuit, circuit: Circuit, load: Array) -> Array:
    """Joint speeds (6, 2), rad/s, at full spool, raising and lowering, at joint angles q (6,).

    ``drives``: as from ``drive_table``; ``rated``: as from ``rated_circuit``; ``circuit`` and ``load`` (6,),
    bar: now. A load that helps opens the flow, one that resists chokes it, with the square root.
    Source: linkage of Petrović & Mattila 2022, x = √(L² + l² + 2 L l cos(q + offset)), slope dx/dq;
    steady piston speed v = K u √((A_a p_s − A_b p_t − F)/(A_a³ + A_b³)) and its mirror image for retraction.
    """
    speeds = np.empty((q.shape[0], 2))
    for i in range(q.shape[0]):
        long, short, ratio = drives[i, LONG], drives[i, SHORT], drives[i, RATIO]
        slope = 1.0
        if long > 0.0:
            angle = q[i] + drives[i, OFFSET]
            length = math.sqrt(long * long + short * short + 2.0 * long * short * math.cos(angle))
            slope = -long * short * math.sin(angle) / length
        lever = max(abs(slope), _LEVER_MIN_M)
        extend = circuit.supply - ratio * circuit.back - load[i]
        extend /= rated.supply - ratio * rated.back
        retract = ratio * circuit.supply - circuit.back + load[i]
        retract /= ratio * rated.supply - rated.back
        out = drives[i, EXTEND] * math.sqrt(max(extend, _AVAILABLE_MIN)) / lever
        back = drives[i, RETRACT] * math.sqrt(max(retract, _AVAILABLE_MIN)) / lever
        speeds[i, 0], speeds[i, 1] = (out, back) if slope > 0.0 else (back, out)
    return speeds
