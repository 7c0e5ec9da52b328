"""Messages of the UDP reference link as plain data; ``protocol.datagram_layout`` has their bytes."""

from typing import NamedTuple, TypeGuard

from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose

ANY_ARM = 0
"""In HELLO in the place of the hash: whatever arm the controller drives."""


class Hello(NamedTuple):
    """Vision PC → controller: asks for a session. ``arm_hash`` may be ``ANY_ARM``."""

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
    state_period_ms: int = 0


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


class StreamedPose(NamedTuple):
    """A reference of the stream ``stream_id``, the id of its START_STREAM; neither repeated nor acknowledged.

    ``number`` rises modulo 2^32. ``time_ns``: the instant of the measurement behind it, vision PC's clock.
    ``twist_ref``: velocity (m/s) and angular velocity (rad/s) in B with which X_BT_ref itself moves.
    """

    stream_id: int
    number: int
    time_ns: int
    X_BT_ref: Pose
    twist_ref: tuple[float, float, float, float, float, float] = (0.0,) * 6


class StreamRefused(NamedTuple):
    """Controller → vision PC: a streamed reference was refused, and why; the one before it stays in force."""

    stream_id: int
    number: int
    reason: Reason
    value: float
    limit: float


class Command(NamedTuple):
    """A command to the group state machine."""

    command_id: int
    code: CommandCode


class Acknowledgement(NamedTuple):
    """Controller → vision PC, one for every command id. ``value`` and ``limit`` (SI) explain a refusal."""

    command_id: int
    reason: Reason
    value: float
    limit: float


def overtaken(command_id: int, newest_id: int) -> Acknowledgement:
    """The answer to request ``command_id``, which is not judged: ``newest_id`` came after it."""
    return Acknowledgement(command_id, Reason.OVERTAKEN, float(command_id), float(newest_id))


class State(NamedTuple):
    """Controller → vision PC, periodic: its own view of the arm (rigid model at the encoders)."""

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
    stream_number: int = 0


class Bye(NamedTuple):
    """Either side: the session ends, with the reason."""

    reason: Reason


class UnusableRequest(NamedTuple):
    """Decoded in place of a request that is laid out correctly but says something no request can say.

    Never sent. The server session answers it with ``reason``, ``value`` and ``limit``; the controller never
    sees it.
    """

    command_id: int
    reason: Reason
    value: float
    limit: float


# bits of State.flags
FLAG_PLANT_LINK_OK = 1 << 0
FLAG_EMERGENCY_LATCHED = 1 << 1
FLAG_SETTLED = 1 << 2
FLAG_STREAMING = 1 << 3

# bits of Hello.capabilities (offered) and Welcome.capabilities (granted)
CAPABILITY_PATHS = 1 << 0
CAPABILITY_STREAMING = 1 << 1
CAPABILITY_AUTHENTICATION = 1 << 2
CAPABILITY_VALVE_TRIALS = 1 << 3

DEFAULT_OFFER = CAPABILITY_PATHS | CAPABILITY_STREAMING | CAPABILITY_VALVE_TRIALS
"""What a client offers where nothing else is chosen."""

Request = ReferencePose | ReferencePath | Command

STOPS = frozenset({CommandCode.STOP, CommandCode.DISABLE, CommandCode.EMERGENCY_STOP})
"""What is judged before all other requests."""


def is_stop(request: Request) -> TypeGuard[Command]:
    """Whether ``request`` goes before all others."""
    return isinstance(request, Command) and request.code in STOPS


def needed_capability(request: Request) -> int:
    """The capability bit without which ``request`` is refused; 0 when it needs none."""
    if isinstance(request, ReferencePath):
        return CAPABILITY_PATHS
    streams = isinstance(request, Command) and request.code in (
        CommandCode.START_STREAM,
        CommandCode.END_STREAM,
    )
    return CAPABILITY_STREAMING if streams else 0


Message = (
    Hello
    | Welcome
    | Heartbeat
    | HeartbeatReply
    | ReferencePose
    | ReferencePath
    | StreamedPose
    | StreamRefused
    | Command
    | Acknowledgement
    | State
    | Bye
)
