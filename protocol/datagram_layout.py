"""Layout of every datagram as data: the codec, the tables of docs/protocol.md and the PLC types come from it.

All numbers are little-endian and sit at a multiple of their own size, so a compiler that packs and one that
aligns give the same structure.
"""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    Hello,
    ReferencePath,
    ReferencePose,
    State,
    StreamedPose,
    StreamRefused,
    Welcome,
)

MAGIC = b"LRLK"
VERSION_MAJOR = 1
VERSION_MINOR = 0
MAX_WAYPOINTS = 24

# Bits 0…7 of the header's flags are optional (a receiver ignores those it does not know), 8…15 are critical
# (a receiver refuses the datagram).
FLAG_ECHO_VALID = 1 << 0
FLAG_AUTHENTICATED = 1 << 8
CRITICAL_FLAGS = 0xFF00
KNOWN_CRITICAL_FLAGS = FLAG_AUTHENTICATED

_TYPE_BYTES = {"B": 1, "H": 2, "I": 4, "Q": 8, "d": 8, "4s": 4, "16s": 16, "x": 1}
_POSE = "x, y, z, then quaternion w, x, y, z"


class Kind(IntEnum):
    """Number of a message on the wire; never renumbered, only appended."""

    HELLO = 1
    WELCOME = 2
    HEARTBEAT = 3
    HEARTBEAT_REPLY = 4
    REFERENCE_POSE = 5
    REFERENCE_PATH = 6
    COMMAND = 7
    ACKNOWLEDGEMENT = 8
    STATE = 9
    BYE = 10
    STREAMED_POSE = 11
    STREAM_REFUSED = 12


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a header or payload: ``count`` numbers of struct type ``code``.

    ``low``…``high`` bound an integer (``high`` None: up to the end of its type, which ``highest`` tells).
    ``poses`` counts the poses that the numbers form. A code of ``x`` is padding: sent as zero, ignored on
    receipt.
    """

    name: str
    code: str
    count: int
    unit: str
    meaning: str
    low: int = 0
    high: int | None = None
    enum: type[IntEnum] | None = None
    poses: int = 0
    highest: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        most = 2 ** (8 * self.size) - 1 if self.high is None else self.high
        object.__setattr__(self, "highest", most)  # asked of every field of every message: found once

    @property
    def size(self) -> int:
        """Bytes that the field occupies."""
        return _TYPE_BYTES[self.code] * self.count


def struct_format(fields: tuple[Field, ...]) -> str:
    """The ``struct`` format string of these fields, little-endian and without implicit padding."""
    return "<" + "".join(f"{f.count}{f.code}" if f.count > 1 else f.code for f in fields)


def size_of(fields: tuple[Field, ...]) -> int:
    """Bytes that these fields occupy together."""
    return sum(field.size for field in fields)


def offsets(fields: tuple[Field, ...]) -> tuple[int, ...]:
    """Byte offset of each field from the first one."""
    return tuple(size_of(fields[:i]) for i in range(len(fields)))


def _padding(count: int) -> Field:
    return Field("padding", "x", count, "", "zero; ignored on receipt")


# fmt: off - one row a field reads as the table that it is
HEADER = (
    Field("magic", "4s", 1, "", "the four characters LRLK"),
    Field("major", "B", 1, "", "version of the layout; a receiver refuses any other", low=1, high=1),
    Field("minor", "B", 1, "", "in HELLO the highest the client speaks, from WELCOME on the negotiated one"),
    Field("kind", "B", 1, "", "which payload follows", enum=Kind),
    Field("spare", "B", 1, "", "zero; ignored on receipt"),
    Field("flags", "H", 1, "bits", "bits 0…7 optional, bits 8…15 critical"),
    Field("payload_bytes", "H", 1, "byte", "length of the payload that follows the header"),
    Field("crc32", "I", 1, "", "CRC-32 over bytes 0…11 and 16…end"),
    Field("session", "Q", 1, "", "0 in HELLO; granted by WELCOME"),
    Field("sequence", "I", 1, "", "one more than in the sender's datagram before, modulo 2^32"),
    Field("echo_sequence", "I", 1, "", "newest sequence received from the peer, if flag bit 0 is set"),
    Field("sent_ns", "Q", 1, "ns", "time of sending on the sender's monotonic clock"),
)
# fmt: on
HEADER_BYTES = size_of(HEADER)
CRC_OFFSET = offsets(HEADER)[[f.name for f in HEADER].index("crc32")]
CRC_BYTES = 4
TAG_BYTES = 16

# Behind the payload of a datagram with FLAG_AUTHENTICATED.
# fmt: off
TRAILER = (
    Field("sequence_high", "I", 1, "", "upper half of the 64-bit number whose lower half is sequence"),
    Field("key_id", "I", 1, "", "tells one shared key from another (clause 11.4)"),
    Field("tag", f"{TAG_BYTES}s", 1, "", "HMAC-SHA-256 over bytes 0…11 and 16…the byte before the tag"),
)
# fmt: on
TRAILER_BYTES = size_of(TRAILER)

_COMMAND_ID = Field("command_id", "Q", 1, "", "number of the request, larger than all before it", 1)
_STREAM_ID = Field("stream_id", "Q", 1, "", "command_id of the START_STREAM that opened the stream", 1)
_DURATION_TEXT = "0: the controller chooses by its speed limits"

# fmt: off
PAYLOADS: dict[Kind, tuple[Field, ...]] = {
    Kind.HELLO: (
        Field("client_nonce", "Q", 1, "", "drawn anew for every attempt to connect", 1),
        Field("capabilities", "Q", 1, "bits", "what the client can use"),
        Field("arm_hash", "Q", 1, "", "hash of the configuration of the arm that is expected; 0: any arm"),
        Field("state_period_ms", "I", 1, "ms", "wanted period of STATE; 0: every scan", high=60_000),
        _padding(4),
    ),
    Kind.WELCOME: (
        Field("client_nonce", "Q", 1, "", "repeated from HELLO", 1),
        Field("capabilities", "Q", 1, "bits", "what both sides can use"),
        Field("arm_hash", "Q", 1, "", "hash of the arm's configuration in use"),
        Field("boot_id", "Q", 1, "", "drawn anew at every start of the controller", 1),
        Field("cycle_ns", "I", 1, "ns", "period of the controller's scan", 1),
        Field("link_timeout_ms", "I", 1, "ms", "silence after which a session ends", 1, 60_000),
        Field("state_period_ms", "I", 1, "ms", "granted period of STATE; 0: every scan", high=60_000),
        _padding(4),
    ),
    Kind.HEARTBEAT: (Field("sent_ns", "Q", 1, "ns", "time of sending, client's clock"),),
    Kind.HEARTBEAT_REPLY: (
        Field("sent_ns", "Q", 1, "ns", "repeated from HEARTBEAT, client's clock"),
        Field("received_ns", "Q", 1, "ns", "time of receipt, controller's clock"),
        Field("replied_ns", "Q", 1, "ns", "time of sending, controller's clock"),
    ),
    Kind.REFERENCE_POSE: (
        _COMMAND_ID,
        Field("X_BT_ref", "d", 7, "m, 1", f"pose of the tool T in the base B: {_POSE}", poses=1),
        Field("duration_s", "d", 1, "s", f"time for the whole motion; {_DURATION_TEXT}"),
    ),
    Kind.REFERENCE_PATH: (
        _COMMAND_ID,
        Field("waypoint_count", "I", 1, "", "waypoints in use", 1, MAX_WAYPOINTS),
        _padding(4),
        Field("waypoints", "d", 7 * MAX_WAYPOINTS, "m, 1", f"T in B, each {_POSE}; unused: 0", poses=24),
        Field("segment_s", "d", 1, "s", f"time for each segment; {_DURATION_TEXT}"),
        Field("dwell_s", "d", 1, "s", "rest at each waypoint"),
    ),
    Kind.COMMAND: (
        _COMMAND_ID,
        Field("code", "I", 1, "", "what is wanted", enum=CommandCode),
        _padding(4),
    ),
    Kind.ACKNOWLEDGEMENT: (
        Field("command_id", "Q", 1, "", "repeated from the request", 1),
        Field("reason", "I", 1, "", "0 accepted, else why it was refused", enum=Reason),
        _padding(4),
        Field("value", "d", 1, "SI", "the quantity that was refused, 0 where there is none"),
        Field("limit", "d", 1, "SI", "the limit that it broke, 0 where there is none"),
    ),
    Kind.STATE: (
        Field("time_ns", "Q", 1, "ns", "instant of the encoder readings, controller's clock"),
        Field("cycle", "Q", 1, "", "number of the scan; from any start"),
        Field("group_state", "H", 1, "", "state of the axes group", enum=GroupState),
        Field("fault", "H", 1, "", "first fault, latched", enum=FaultCode),
        Field("severity", "H", 1, "", "reaction to that fault", enum=Severity),
        Field("flags", "H", 1, "bits", "see the table of state flags"),
        Field("motion_id", "Q", 1, "", "command id of the motion last accepted; 0: none yet"),
        Field("motion_done", "I", 1, "", "1: that motion has been driven to its end (7.8)", high=1),
        Field("segment", "I", 1, "", "segment of the path being driven, from 0"),
        Field("q_meas", "d", 6, "rad", "measured joints: slew, lift, tilt, wrist 1, wrist 2, wrist 3"),
        Field("q_cmd", "d", 6, "rad", "commanded joints, same order"),
        Field("valves", "d", 6, "1", "spool commands −1…1, positive raises the joint angle"),
        Field("X_BT", "d", 7, "m, 1", f"tool in base, rigid model at the encoders: {_POSE}", poses=1),
        Field("X_BT_cmd", "d", 7, "m, 1", f"tool in base, as commanded: {_POSE}", poses=1),
        Field("supply_bar", "d", 1, "bar", "supply pressure, absolute"),
        Field("overruns", "I", 1, "", "scans that missed their deadline since start"),
        Field("lateness_p50_us", "I", 1, "µs", "median lateness of the scan, last window"),
        Field("lateness_p99_us", "I", 1, "µs", "99th percentile of it"),
        Field("lateness_max_us", "I", 1, "µs", "its maximum since start"),
        Field("references_lost", "I", 1, "", "datagrams of the client that never came; from any start"),
        Field("references_dropped", "I", 1, "", "datagrams that came and were not used; from any start"),
        Field("plant_exchange_failures", "I", 1, "", "failed fieldbus exchanges since start"),
        Field("stream_number", "I", 1, "", "newest streamed reference accepted, if flag STREAMING is set"),
    ),
    Kind.BYE: (Field("reason", "I", 1, "", "why the session ends", enum=Reason), _padding(4)),
    Kind.STREAMED_POSE: (
        _STREAM_ID,
        Field("number", "I", 1, "", "newer than all before it in the stream, modulo 2^32"),
        _padding(4),
        Field("time_ns", "Q", 1, "ns", "instant of the measurement that it rests on, client's clock"),
        Field("X_BT_ref", "d", 7, "m, 1", f"pose of the tool T in the base B: {_POSE}", poses=1),
        Field("twist_ref", "d", 6, "m/s, rad/s", "how X_BT_ref moves: velocity, then angular velocity, in B"),
    ),
    Kind.STREAM_REFUSED: (
        _STREAM_ID,
        Field("number", "I", 1, "", "repeated from the streamed reference"),
        Field("reason", "I", 1, "", "why it was refused", enum=Reason),
        Field("value", "d", 1, "SI", "the quantity that was refused, 0 where there is none"),
        Field("limit", "d", 1, "SI", "the limit that it broke, 0 where there is none"),
    ),
}
# fmt: on

# Any: the message classes are tuples of different fields; the table is what ties them to their layout.
MESSAGE_TYPES: dict[Kind, type[Any]] = {
    Kind.HELLO: Hello,
    Kind.WELCOME: Welcome,
    Kind.HEARTBEAT: Heartbeat,
    Kind.HEARTBEAT_REPLY: HeartbeatReply,
    Kind.REFERENCE_POSE: ReferencePose,
    Kind.REFERENCE_PATH: ReferencePath,
    Kind.COMMAND: Command,
    Kind.ACKNOWLEDGEMENT: Acknowledgement,
    Kind.STATE: State,
    Kind.BYE: Bye,
    Kind.STREAMED_POSE: StreamedPose,
    Kind.STREAM_REFUSED: StreamRefused,
}
MAX_DATAGRAM_BYTES = HEADER_BYTES + max(size_of(fields) for fields in PAYLOADS.values()) + TRAILER_BYTES
