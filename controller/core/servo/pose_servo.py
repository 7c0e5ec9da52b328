"""The Cartesian law: desired joint speeds from a desired motion of the tool.

Source: Mäkinen et al. 2023, (4) qd_d = J⁻¹ [pd_d + K_p (p_d − p); ω_d + K_θ δr]; its integral (5) is the
joint command.
"""

from typing import NamedTuple

import numpy as np

from controller.core.kinematics.denavit_hartenberg import chain
from controller.core.kinematics.jacobian import damped_inverse, geometric_jacobian
from controller.core.kinematics.rotations import Array, orientation_error, quaternion_from_matrix
from controller.core.trajectories.paths import Desired
from foundation.compiled import kernel


class ServoGains(NamedTuple):
    """K_p and K_θ (1/s), dead zone of the integral (rad), damping: its onset (σ) and its greatest λ."""

    position: float
    orientation: float
    dead_zone: float
    damping_onset: float
    damping_max: float


class ToolState(NamedTuple):
    """Where the tool is: p_BT (3,), unit quaternion (4,), J_BT (6, 6)."""

    p_BT: Array
    quaternion: Array
    J_BT: Array


class Resolved(NamedTuple):
    """What (4) says at one instant.

    ``qd_cmd``: desired joint speeds (6,). ``q_error``: the joint-equivalent J⁻¹ [p_d − p; 2 δr] (6,) of
    what is left.
    ``least_singular_value`` and ``damping_squared`` as from ``jacobian.damped_inverse``.
    """

    qd_cmd: Array
    q_error: Array
    least_singular_value: float
    damping_squared: float


@kernel
def tool_state(table: Array, q: Array) -> ToolState:
    """The ToolState at joint angles q (6,); ``table`` as from ``denavit_hartenberg.dh_table``."""
    frames = chain(table, q)
    tip = frames[frames.shape[0] - 1]
    quaternion = quaternion_from_matrix(tip[:, :3].copy())
    return ToolState(tip[:, 3].copy(), quaternion, geometric_jacobian(frames))


@kernel
def resolve(tool: ToolState, desired: Desired, gains: ServoGains) -> Resolved:
    """Desired joint speeds (4) that bring ``tool`` to ``desired``.

    Why a dead zone: p comes from the encoders, so (4) with (5) is integral action around (6); on stick and
    slip an integral never rests but hunts. A joint whose share of the error is inside the zone stops
    integrating. δr counts half the angle, so K_θ = 2 K_p turns and moves at one pace.
    """
    inverse, least, square = damped_inverse(tool.J_BT, gains.damping_onset, gains.damping_max)
    turn = orientation_error(desired.quaternion, tool.quaternion)
    path, correction, gap = np.empty(6), np.empty(6), np.empty(6)
    for k in range(3):
        left = desired.p[k] - tool.p_BT[k]
        path[k], path[k + 3] = desired.v[k], desired.omega[k]
        gap[k], gap[k + 3] = left, 2.0 * turn[k]
        correction[k], correction[k + 3] = gains.position * left, gains.orientation * turn[k]
    q_error = inverse @ gap
    qd_cmd = inverse @ path
    qd_back = inverse @ correction
    for i in range(6):
        size = abs(q_error[i])
        if size > gains.dead_zone:  # a continuous dead zone
            qd_cmd[i] += qd_back[i] * (size - gains.dead_zone) / size
    return Resolved(qd_cmd, q_error, least, square)
