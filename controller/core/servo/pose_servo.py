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


def tool_state(table: Array, q: Array) -> ToolState:
    """The ToolState at joint angles q (6,); ``table`` as from ``denavit_hartenberg.dh_table``."""
    return ToolState(*_tool_state(table, q))


def resolve(tool: ToolState, desired: Desired, gains: Array) -> Resolved:
    """Desired joint speeds (4) that bring ``tool`` to ``desired``.

    ``gains``: K_p, K_θ (1/s), dead zone (rad), damping onset (σ), greatest damping λ.
    Why a dead zone: p comes from the encoders, so (4) with (5) is integral action around (6); on stick and
    slip an integral never rests but hunts. A joint whose share of the error is inside the zone stops
    integrating. δr counts half the angle, so K_θ = 2 K_p turns and moves at one pace.
    """
    p_d, v_d, _, quaternion_d, omega_d, _ = desired
    return Resolved(*_resolve(*tool, p_d, v_d, quaternion_d, omega_d, gains))


@kernel
def _tool_state(table: Array, q: Array) -> tuple[Array, Array, Array]:
    frames = chain(table, q)
    tip = frames[frames.shape[0] - 1]
    return tip[:, 3].copy(), quaternion_from_matrix(tip[:, :3].copy()), geometric_jacobian(frames)


@kernel
def _resolve(
    p: Array,
    quaternion: Array,
    J: Array,
    p_d: Array,
    v_d: Array,
    quaternion_d: Array,
    omega_d: Array,
    gains: Array,
) -> tuple[Array, Array, float, float]:
    inverse, least, square = damped_inverse(J, gains[3], gains[4])
    turn = orientation_error(quaternion_d, quaternion)
    path, correction, gap = np.empty(6), np.empty(6), np.empty(6)
    for k in range(3):
        path[k], path[k + 3] = v_d[k], omega_d[k]
        gap[k], gap[k + 3] = p_d[k] - p[k], 2.0 * turn[k]
        correction[k], correction[k + 3] = gains[0] * (p_d[k] - p[k]), gains[1] * turn[k]
    q_error = inverse @ gap
    qd_cmd = inverse @ path
    qd_back = inverse @ correction
    for i in range(6):
        size = abs(q_error[i])
        if size > gains[2]:  # a continuous dead zone
            qd_cmd[i] += qd_back[i] * (size - gains[2]) / size
    return qd_cmd, q_error, least, square
