"""Datagrams of the UDP reference link: messages as plain data, and their codec."""

from typing import NamedTuple

from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose

MAX_WAYPOINTS = 24


class Hello(NamedTuple):
    """Vision PC → controller: asks for a session. ``arm_hash`` 0 means any arm."""

    client_nonce: int
    capabilities: int
    arm_hash: int
    state_period_ms: int


class Welcome(NamedTuple):
    """Controller → vision PC: the session is granted (its number is in the header)."""

    client_nonce: int
    capabilities: int
    arm_hash: int
    boot_id: int
    cycle_ns: int
    link_timeout_ms: int


class Heartbeat(NamedTuple):
    """Vision PC → controller; ``sent_ns`` on the vision PC's clock."""

    sent_ns: int


class HeartbeatReply(NamedTuple):
    """Controller → vision PC: echo with the controller's receive and send times on its own clock."""

    sent_ns: int
    received_ns: int
    replied_ns: int


class ReferencePose(NamedTuple):
    """Point-to-point reference X_BT_ref. ``duration_s`` 0 lets the controller choose by its speed limits."""

    command_id: int
    X_BT_ref: Pose
    duration_s: float


class ReferencePath(NamedTuple):
    """Waypoints 1…24, passed in order, at rest at each; times as in ReferencePose for every segment alike."""

    command_id: int
    waypoints: tuple[Pose, ...]
    segment_s: float
    dwell_s: float


class Command(NamedTuple):
    """A command to the group state machine."""

    command_id: int
    code: CommandCode


class Acknowledgement(NamedTuple):
    """Controller → vision PC, exactly one for every command id. ``value`` and ``limit`` explain a refusal (SI)."""

    command_id: int
    reason: Reason
    value: float
    limit: float


class State(NamedTuple):
    """Controller → vision PC, periodic: the controller's own view of the arm (rigid model at the encoders)."""

    time_ns: int
    cycle: int
    group_state: GroupState
    fault: FaultCode
    severity: Severity
    flags: int
    motion_id: int
    motion_done: bool
    segment: int
    q_meas: tuple[float, float, float, float, float, float]
    q_cmd: tuple[float, float, float, float, float, float]
    valves: tuple[float, float, float, float, float, float]
    X_BT: Pose
    X_BT_cmd: Pose
    supply_bar: float
    overruns: int
    lateness_p50_us: int
    lateness_p99_us: int
    lateness_max_us: int
    references_lost: int
    references_dropped: int
    plant_exchange_failures: int


class Bye(NamedTuple):
    """Either side: the session ends, with the reason."""

    reason: Reason


# bits of State.flags
FLAG_PLANT_LINK_OK = 1 << 0
FLAG_EMERGENCY_LATCHED = 1 << 1
FLAG_SETTLED = 1 << 2

Message = (
    Hello | Welcome | Heartbeat | HeartbeatReply | ReferencePose | ReferencePath | Command | Acknowledgement | State | Bye
)
