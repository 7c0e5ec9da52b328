"""Codec of the reference link: one message and its header ⇄ the bytes of one datagram.

Numbers that are NaN or infinite pass: whether a pose makes sense is for the controller to refuse with a
reason, and a refusal can be acknowledged only if the request was decoded.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from zlib import crc32

from protocol.authentication import DirectionKey
from protocol.datagram_layout import (
    CRC_BYTES,
    CRC_OFFSET,
    CRITICAL_FLAGS,
    FLAG_AUTHENTICATED,
    HEADER,
    HEADER_BYTES,
    KNOWN_CRITICAL_FLAGS,
    MAGIC,
    MAX_DATAGRAM_BYTES,
    MAX_WAYPOINTS,
    MESSAGE_TYPES,
    PAYLOADS,
    TRAILER_BYTES,
    VERSION_MAJOR,
    VERSION_MINOR,
    Field,
    Kind,
    struct_format,
)
from protocol.errors import DatagramRefused, RequestRefused
from protocol.faults import Reason
from protocol.pose import Pose
from protocol.reference_messages import Command, Message, ReferencePath, Request, UnusableRequest

_HEADER_STRUCT = struct.Struct(struct_format(HEADER))
_CRC_STRUCT = struct.Struct("<I")
_TRAILER_START = struct.Struct("<II")
_HALF = 32
_LOWER_HALF = (1 << _HALF) - 1
_CRC_END = CRC_OFFSET + CRC_BYTES


class Header(NamedTuple):
    """What every datagram carries; ``echo_sequence`` means something only with FLAG_ECHO_VALID.

    ``sequence`` has 32 bits, in an authenticated datagram 64, of which the upper ones travel in the trailer.
    """

    session: int
    sequence: int
    sent_ns: int
    echo_sequence: int = 0
    flags: int = 0
    minor: int = VERSION_MINOR


class Datagram(NamedTuple):
    """One decoded datagram."""

    header: Header
    message: Message | UnusableRequest


class _Codec(NamedTuple):
    kind: Kind
    layout: struct.Struct
    fields: tuple[Field, ...]
    type: Callable[..., Message]


# The number of waypoints is not a field of the message: it follows from their tuple.
_CODECS: dict[int, _Codec] = {
    kind: _Codec(
        kind,
        struct.Struct(struct_format(fields)),
        tuple(field for field in fields if field.code != "x" and field.name != "waypoint_count"),
        MESSAGE_TYPES[kind],
    )
    for kind, fields in PAYLOADS.items()
}
_MEMBERS = {
    field.enum: {member.value: member for member in field.enum}
    for fields in PAYLOADS.values()
    for field in fields
    if field.enum is not None
}
_CODEC_OF_TYPE = {codec.type: codec for codec in _CODECS.values()}


def encode(message: Message, header: Header, key: DirectionKey | None = None) -> bytes:
    """The bytes of one datagram, signed with ``key`` if there is one.

    Raises RequestRefused (``refused.not_encodable``), naming the field, when a value does not fit its range.
    """
    codec = _CODEC_OF_TYPE[type(message)]
    flags, sequence, trailer = header.flags & ~FLAG_AUTHENTICATED, header.sequence, b""
    try:
        payload = codec.layout.pack(*_flattened(message, codec))
        if key is not None:
            trailer = _TRAILER_START.pack(sequence >> _HALF, key.key_id)
            flags, sequence = flags | FLAG_AUTHENTICATED, sequence & _LOWER_HALF
        head = _HEADER_STRUCT.pack(
            MAGIC, VERSION_MAJOR, header.minor, codec.kind, 0, flags, len(payload), 0,
            header.session, sequence, header.echo_sequence, header.sent_ns,
        )  # fmt: skip
    except struct.error as error:
        why = f"{codec.kind.name}: {error} in {message} with {header}"
        raise RequestRefused("refused.not_encodable", why) from error
    body = head[_CRC_END:] + payload
    if key is not None:
        body += trailer + key.tag(head + payload + trailer)
    checksum = crc32(body, crc32(head[:CRC_OFFSET]))
    return head[:CRC_OFFSET] + _CRC_STRUCT.pack(checksum) + body


def decode(datagram: bytes) -> Datagram:
    """Header and message of one datagram.

    Raises DatagramRefused for anything but an intact datagram of this major version with a known kind,
    exactly its length, and integers in range. The cause names the first check that failed, in the order
    of docs/protocol.md. Whether a tag is there and right is for the session to judge
    (``protocol.authentication.fault_of``), which knows the key.
    """
    kind, header, payload = _open(datagram)
    codec = _CODECS.get(kind)
    if codec is None:
        raise DatagramRefused("datagram.unknown_kind", f"kind {kind}: not one of 1…{max(Kind)}")
    if len(payload) != codec.layout.size:
        why = f"{codec.kind.name}: {len(payload)} bytes, wanted {codec.layout.size}"
        raise DatagramRefused("datagram.wrong_payload_length", why)
    numbers = codec.layout.unpack(payload)
    message = _path(numbers) if codec.type is ReferencePath else _message(numbers, codec)
    return Datagram(header, message)


def content_of(request: Request | UnusableRequest) -> bytes:
    """What ``request`` asks for, byte for byte: the same when it comes again, whatever is in its padding."""
    if isinstance(request, UnusableRequest):
        return repr(request).encode()
    codec = _CODEC_OF_TYPE[type(request)]
    return codec.layout.pack(*_flattened(request, codec))


def _open(datagram: bytes) -> tuple[int, Header, bytes]:
    size = len(datagram)
    if size < HEADER_BYTES:
        raise DatagramRefused("datagram.too_short", f"{size} bytes: a header alone has {HEADER_BYTES}")
    if size > MAX_DATAGRAM_BYTES:
        raise DatagramRefused("datagram.too_long", f"{size} bytes: the limit is {MAX_DATAGRAM_BYTES}")
    head = _HEADER_STRUCT.unpack_from(datagram)
    (
        magic,
        major,
        minor,
        kind,
        _,
        flags,
        payload_bytes,
        checksum,
        session,
        sequence,
        echo_sequence,
        sent_ns,
    ) = head
    if magic != MAGIC:
        raise DatagramRefused("datagram.bad_magic", f"magic {magic.hex()}: wanted {MAGIC.hex()}")
    if major != VERSION_MAJOR:
        raise DatagramRefused("datagram.wrong_major", f"major version {major}: wanted {VERSION_MAJOR}")
    after_payload = TRAILER_BYTES if flags & FLAG_AUTHENTICATED else 0
    if payload_bytes != size - HEADER_BYTES - after_payload:
        why = f"payload of {size - HEADER_BYTES - after_payload} bytes: the header says {payload_bytes}"
        raise DatagramRefused("datagram.bad_length", why)
    if checksum != crc32(datagram[_CRC_END:], crc32(datagram[:CRC_OFFSET])):
        raise DatagramRefused("datagram.bad_crc", f"CRC-32 {checksum:08x} does not match the content")
    if flags & CRITICAL_FLAGS & ~KNOWN_CRITICAL_FLAGS:
        raise DatagramRefused("datagram.unknown_critical_flag", f"flags {flags:04x}: unknown critical bit")
    if after_payload:
        sequence |= _TRAILER_START.unpack_from(datagram, HEADER_BYTES + payload_bytes)[0] << _HALF
    payload = datagram[HEADER_BYTES : HEADER_BYTES + payload_bytes]
    return kind, Header(session, sequence, sent_ns, echo_sequence, flags, minor), payload


def _flattened(message: Message, codec: _Codec) -> list[Any]:
    values: list[Any] = []
    # Any: which field has which type is the table's knowledge, not the type checker's.
    fields: tuple[Any, ...] = message
    for field, value in zip(codec.fields, fields, strict=True):
        if field.poses > 1:
            _flatten_waypoints(value, values)
        elif field.poses:
            values += value.p_m
            values += value.q_wxyz
        elif field.count > 1:
            values += value
        else:
            if field.code != "d" and not field.low <= value <= field.highest:
                raise struct.error(f"{field.name} = {value}: wanted {field.low}…{field.highest}")
            values.append(value)
    return values


def _flatten_waypoints(waypoints: Sequence[Pose], values: list[Any]) -> None:
    if not 1 <= len(waypoints) <= MAX_WAYPOINTS:
        raise struct.error(f"{len(waypoints)} waypoints: wanted 1…{MAX_WAYPOINTS}")
    values.append(len(waypoints))
    for waypoint in waypoints:
        values += waypoint.p_m
        values += waypoint.q_wxyz
    values += (0.0,) * (7 * (MAX_WAYPOINTS - len(waypoints)))


def _message(numbers: tuple[Any, ...], codec: _Codec) -> Message | UnusableRequest:
    values: list[Any] = []
    at = 0
    for field in codec.fields:
        if field.poses:
            values.append(_pose(numbers, at))
        elif field.count > 1:
            values.append(numbers[at : at + field.count])
        elif field.code == "d":
            values.append(numbers[at])
        elif field.enum is not None:
            member = _MEMBERS[field.enum].get(numbers[at])
            if member is not None:
                values.append(member)
            elif codec.type is Command:
                return UnusableRequest(values[0], Reason.UNKNOWN_COMMAND, float(numbers[at]), 0.0)
            else:
                raise _bad_value(codec.kind, field.name, numbers[at])
        elif field.low <= numbers[at] <= field.highest:
            values.append(bool(numbers[at]) if field.name == "motion_done" else numbers[at])
        else:
            raise _bad_value(codec.kind, field.name, numbers[at])
        at += field.count
    return codec.type(*values)


def _path(numbers: tuple[Any, ...]) -> ReferencePath | UnusableRequest:
    command_id, count = numbers[:2]
    if command_id < 1:
        raise _bad_value(Kind.REFERENCE_PATH, "command_id", command_id)
    if count == 0:
        return UnusableRequest(command_id, Reason.EMPTY_PATH, 0.0, 1.0)
    if count > MAX_WAYPOINTS:
        return UnusableRequest(command_id, Reason.TOO_MANY_WAYPOINTS, float(count), float(MAX_WAYPOINTS))
    waypoints = tuple(_pose(numbers, at) for at in range(2, 2 + 7 * count, 7))
    return ReferencePath(command_id, waypoints, numbers[-2], numbers[-1])


def _pose(numbers: tuple[Any, ...], at: int) -> Pose:
    x, y, z, qw, qx, qy, qz = numbers[at : at + 7]
    return Pose((x, y, z), (qw, qx, qy, qz))


def _bad_value(kind: Kind, name: str, value: int) -> DatagramRefused:
    return DatagramRefused("datagram.bad_value", f"{kind.name}.{name} = {value}: outside its range")
