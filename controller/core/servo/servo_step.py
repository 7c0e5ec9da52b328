"""One step of the servo, from a desired motion to valve commands, in one kernel.

Called from Python, a kernel spends half a microsecond on every array that it returns, more than on most of
its arithmetic. So the laws, each a kernel with tests of its own, are called one after the other in here, and
the results go where the caller wants them.
"""

from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.drives import Circuit, full_spool_speeds
from controller.core.servo.joint_control import JointFilters, JointGains, Pressures, valve_commands
from controller.core.servo.pose_servo import ServoGains, ToolState, resolve
from controller.core.trajectories.paths import Desired
from foundation.compiled import kernel

# Rows of the result, each (6,): joint command (rad), its speed (rad/s), valve commands, filters' two outputs,
# last ways of the spools (sense, furthest), what is left to the desired pose (rad), slow pilot
# pressures (bar).
Q_CMD, QD_CMD, VALVES, PT1, LOAD, SENSE, FURTHEST, LEFT, PILOT = range(9)
ROWS = 9


class ServoConstants(NamedTuple):
    """What the servo's laws are set to. ``drives``, ``rated``: see ``drives.full_spool_speeds``.

    ``tolerance`` (rad): of the joint-equivalent error inside which the arm counts as settled.
    """

    gains: ServoGains
    joints: JointGains
    drives: Array
    rated: Circuit
    tolerance: float


class ServoInput(NamedTuple):
    """What one step starts from. ``rate``: of time along the way, and share of the valve commands.

    ``felt``: on the joints now; ``circuit`` and ``slow_load`` (6,): what the drives' speeds are
    taken at. ``q_meas``, ``q_cmd`` (6,): measured and commanded before.
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


@kernel
def servo_step(constants: ServoConstants, given: ServoInput, dt_s: float, out: Array) -> tuple[bool, bool]:
    """Whether all valve commands are finite, and whether the tool is inside the tolerance.

    Fills ``out`` (9, 6), rows Q_CMD … PILOT. Source: (4), (5), (6), (25).
    """
    desired, rate = given.desired, given.rate
    if rate != 1.0:  # accelerations are left, the servo does not use them
        v, omega = rate * desired.v, rate * desired.omega
        desired = Desired(desired.p, v, desired.a, desired.quaternion, omega, desired.alpha)
    resolved = resolve(given.tool, desired, constants.gains)
    q_cmd = given.q_cmd + dt_s * resolved.qd_cmd
    speeds = full_spool_speeds(
        constants.drives, given.q_meas, constants.rated, given.circuit, given.slow_load
    )
    valves, filters = valve_commands(
        constants.joints, given.filters, q_cmd - given.q_meas, resolved.qd_cmd, given.felt, speeds, dt_s
    )
    finite, inside = True, True
    for i in range(6):
        out[Q_CMD, i], out[QD_CMD, i], out[VALVES, i] = q_cmd[i], resolved.qd_cmd[i], rate * valves[i]
        out[PT1, i], out[LOAD, i], out[LEFT, i] = filters.pt1[i], filters.load[i], resolved.q_error[i]
        out[SENSE, i], out[FURTHEST, i] = filters.sense[i], filters.furthest[i]
        out[PILOT, i] = filters.pilot[i]
        finite = finite and np.isfinite(valves[i])
        inside = inside and abs(resolved.q_error[i]) <= constants.tolerance
    return finite, inside
