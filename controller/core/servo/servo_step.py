"""One step of the servo, from a desired motion to valve commands, in one kernel.

Called from Python, a kernel spends half a microsecond on every array that it returns, more than on most of
its arithmetic. So the laws, each a kernel with tests of its own, are called one after the other in here, and
the results go where the caller wants them.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.denavit_hartenberg import chain, damped_inverse, geometric_jacobian
from controller.core.kinematics.rotations import Array, orientation_error, quaternion_from_matrix
from controller.core.servo.joint_control import JointFilters, JointGains, Pressures, valve_commands
from controller.core.servo.settling import Settling, settle_joint
from controller.core.trajectories.paths import Desired
from foundation.compiled import kernel
from nominal_arm.description import CylinderDrive, Drive, RatedSupply

# A cylinder's lever arm vanishes at the ends of a linkage; below this the map is held constant.
_LEVER_MIN_M = 0.05  # [D]
# The least share of the rated pressure that counts as available: a stalled drive still has a finite gain.
_AVAILABLE_MIN = 0.1  # [D]


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


class ServoGains(NamedTuple):
    """K_p and K_θ (1/s), damping: its onset (σ) and its greatest λ."""

    position: float
    orientation: float
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
def resolve(tool: ToolState, desired: Desired, gains: ServoGains, dead_zones: Array) -> Resolved:
    """Desired joint speeds (4) that bring ``tool`` to ``desired``.

    Why a dead zone: p comes from the encoders, so (4) with (5) is integral action around (6); on stick and
    slip an integral never rests but hunts. A joint whose share of the error is inside its zone of
    ``dead_zones`` (6,), rad, stops integrating. δr counts half the angle, so K_θ = 2 K_p turns
    and moves at one pace.
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
        if size > dead_zones[i]:  # a continuous dead zone
            qd_cmd[i] += qd_back[i] * (size - dead_zones[i]) / size
    return Resolved(qd_cmd, q_error, least, square)


# Rows of the result, each (6,): joint command (rad), its speed (rad/s), valve commands, filters' two outputs,
# last ways of the spools (sense, furthest), what is left to the desired pose (rad), slow pilot
# pressures (bar), the three rows of ``Settling``.
Q_CMD, QD_CMD, VALVES, PT1, LOAD, SENSE, FURTHEST, LEFT, PILOT, HELD, ERROR, STOOD = range(12)
ROWS = 12


class ServoConstants(NamedTuple):
    """What the servo's laws are set to. ``drives``, ``rated``: see ``drives.full_spool_speeds``.

    Of the joint-equivalent error (rad): ``dead_zone``, inside which a joint's integral stops, and
    ``tolerance``, beyond which it begins again and inside which the arm counts as settled.
    """

    gains: ServoGains
    joints: JointGains
    drives: Array
    rated: Circuit
    dead_zone: float
    tolerance: float


class ServoInput(NamedTuple):
    """What one step starts from. ``rate``: of time along the way, and share of the valve commands.

    ``felt``: on the joints now; ``circuit`` and ``slow_load`` (6,): what the drives' speeds are
    taken at. ``q_meas``, ``q_cmd`` (6,): measured and commanded before; ``settling``: before.
    """

    tool: ToolState
    desired: Desired
    rate: float
    q_meas: Array
    q_cmd: Array
    filters: JointFilters
    felt: Pressures
    circuit: Circuit
    slow_load: Array
    settling: Settling


@kernel
def servo_step(constants: ServoConstants, given: ServoInput, dt_s: float, out: Array) -> tuple[bool, bool]:
    """Whether all valve commands are finite, and whether all joints stand still inside the tolerance.

    Fills ``out`` (12, 6), rows Q_CMD … STOOD. Source: (4), (5), (6), (25).
    """
    desired, rate, dead_zone = given.desired, given.rate, constants.dead_zone
    if rate != 1.0:  # accelerations are left, the servo does not use them
        v, omega = rate * desired.v, rate * desired.omega
        desired = Desired(desired.p, v, desired.a, desired.quaternion, omega, desired.alpha)
    dead_zones = np.where(given.settling.held > 0.0, constants.tolerance, dead_zone)
    resolved = resolve(given.tool, desired, constants.gains, dead_zones)
    q_cmd = given.q_cmd + dt_s * resolved.qd_cmd
    speeds = full_spool_speeds(
        constants.drives, given.q_meas, constants.rated, given.circuit, given.slow_load
    )
    valves, filters = valve_commands(
        constants.joints, given.filters, q_cmd - given.q_meas, resolved.qd_cmd, given.felt, speeds, dt_s
    )
    finite, stands = True, True
    for i in range(6):
        out[Q_CMD, i], out[QD_CMD, i], out[VALVES, i] = q_cmd[i], resolved.qd_cmd[i], rate * valves[i]
        out[PT1, i], out[LOAD, i], out[LEFT, i] = filters.pt1[i], filters.load[i], resolved.q_error[i]
        out[SENSE, i], out[FURTHEST, i] = filters.sense[i], filters.furthest[i]
        out[PILOT, i] = filters.pilot[i]
        finite = finite and np.isfinite(valves[i])
        out[HELD, i], out[ERROR, i], out[STOOD, i], still = settle_joint(
            i, given.settling, resolved.q_error[i], (dead_zone, constants.tolerance), dt_s
        )
        stands = stands and still
    return finite, stands
