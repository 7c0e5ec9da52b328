"""One line for a person, or one object for a program, for each datagram of the reference link."""

from enum import IntEnum
from typing import Any

from protocol.datagram_layout import FLAG_ECHO_VALID, MAGIC
from protocol.errors import DatagramRefused
from protocol.pose import Pose
from protocol.reference_link import decode
from testbed.dissector.capture import UdpPacket

_HIDDEN_IN_LINES = ("q_cmd", "X_BT_cmd", "lateness_p50_us", "lateness_p99_us", "lateness_max_us")


def is_ours(packet: UdpPacket, port: int) -> bool:
    """Whether it belongs to the reference link: by its magic, or by the controller's port (0: any)."""
    if port and port not in (packet.source[1], packet.destination[1]):
        return False
    return bool(port) or packet.data.startswith(MAGIC)


def as_fields(packet: UdpPacket) -> dict[str, Any]:
    """The packet as plain data; a datagram that a receiver would drop has ``refused`` with the cause."""
    fields: dict[str, Any] = {
        "time_s": packet.time_s,
        "source": f"{packet.source[0]}:{packet.source[1]}",
        "destination": f"{packet.destination[0]}:{packet.destination[1]}",
        "bytes": len(packet.data),
    }
    try:
        header, message = decode(packet.data)
    except DatagramRefused as refusal:
        return fields | {"refused": refusal.cause, "detail": str(refusal)}
    echo = header.echo_sequence if header.flags & FLAG_ECHO_VALID else None
    return fields | {
        "message": type(message).__name__,
        "session": f"{header.session:016x}",
        "sequence": header.sequence,
        "echo": echo,
        "sent_ns": header.sent_ns,
        "fields": {name: _plain(value) for name, value in message._asdict().items()},
    }


def as_line(packet: UdpPacket, began_s: float) -> str:
    """The packet in one line; times since ``began_s``."""
    fields = as_fields(packet)
    head = f"{packet.time_s - began_s:10.6f} {fields['source']} → {fields['destination']}"
    if "refused" in fields:
        return f"{head} {fields['bytes']} bytes refused: {fields['detail']}"
    said = " ".join(
        f"{name}={_short(value)}" for name, value in fields["fields"].items() if name not in _HIDDEN_IN_LINES
    )
    echo = "" if fields["echo"] is None else f" echo={fields['echo']}"
    return f"{head} {fields['message']} seq={fields['sequence']}{echo} {said}"


def _plain(value: Any) -> Any:
    if isinstance(value, IntEnum):
        return value.name
    if isinstance(value, Pose):
        return {"p_m": list(value.p_m), "q_wxyz": list(value.q_wxyz)}
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return value


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, dict):
        return "".join(_short(part) for part in value.values())
    if isinstance(value, list):
        return "[" + " ".join(_short(each) for each in value) + "]"
    return str(value)
