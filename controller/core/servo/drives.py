"""Nominal joint speed at full spool: rotary actuators directly, cylinders through their triangle linkage."""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel
from nominal_arm.description import CylinderDrive, Drive, RatedSupply

# A cylinder's lever arm vanishes at the ends of a linkage; below this the map is held constant.
_LEVER_MIN_M = 0.05
# The least share of the rated pressure that counts as available: a stalled drive still has a finite gain.
_AVAILABLE_MIN = 0.1


def drive_table(drives: tuple[Drive, ...]) -> Array:
    """Array (6, 6): long, short, angle offset, extend and retract speed, area ratio; long = 0: rotary."""
    return np.array(
        [
            [d.long_m, d.short_m, d.angle_offset_rad, d.extend_m_s, d.retract_m_s, d.area_ratio]
            if isinstance(d, CylinderDrive)
            else [0.0, 0.0, 0.0, d.speed_rad_s, d.speed_rad_s, 1.0]
            for d in drives
        ]
    )


def unloaded(rated: RatedSupply) -> Array:
    """The circuit at which the rated speeds hold: supply and return pressure (bar), and no load (6 zeros)."""
    return np.array([rated.supply_bar, rated.return_bar, *[0.0] * 6])


def load_pressures(drives: Array, pressures_bar: tuple[tuple[float, float], ...]) -> Array:
    """What the loads put on the actuators (6,), bar, referred to chamber a: p_a − ratio · p_b."""
    chambers = np.array(pressures_bar)
    load: Array = chambers[:, 0] - drives[:, 5] * chambers[:, 1]
    return load


@kernel
def full_spool_speeds(drives: Array, q: Array, rated: Array, circuit: Array) -> Array:
    """Joint speeds (6, 2), rad/s, at full spool, raising and lowering, at joint angles q (6,).

    ``rated`` and ``circuit``: supply, return and six load pressures (bar), as from ``unloaded``: where the
    table's speeds hold, and now. A load that helps opens the flow, one that resists chokes it, with the
    square root. Source: linkage of Petrović & Mattila 2022, x = √(L² + l² + 2 L l cos(q + offset)), lever
    dx/dq; steady piston speed v = K u √((A_a p_s − A_b p_t − F)/(A_a³ + A_b³)) and its mirror image for
    retraction.
    """
    speeds = np.empty((drives.shape[0], 2))
    for i in range(drives.shape[0]):
        long, short, ratio = drives[i, 0], drives[i, 1], drives[i, 5]
        lever = 1.0
        if long > 0.0:
            angle = q[i] + drives[i, 2]
            length = math.sqrt(long * long + short * short + 2.0 * long * short * math.cos(angle))
            lever = -long * short * math.sin(angle) / length
        arm = max(abs(lever), _LEVER_MIN_M)
        extend = (circuit[0] - ratio * circuit[1] - circuit[2 + i]) / (rated[0] - ratio * rated[1])
        retract = (ratio * circuit[0] - circuit[1] + circuit[2 + i]) / (ratio * rated[0] - rated[1])
        out = drives[i, 3] * math.sqrt(max(extend, _AVAILABLE_MIN)) / arm
        back = drives[i, 4] * math.sqrt(max(retract, _AVAILABLE_MIN)) / arm
        speeds[i, 0], speeds[i, 1] = (out, back) if lever > 0.0 else (back, out)
    return speeds
