"""One line for a person, or one object for a program, for each datagram of the reference link."""

import itertools
import json
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from dissector.capture import UdpPacket, from_file, from_interface
from foundation.secret_source import key_from_file
from protocol.authentication import ChannelKeys, DirectionKey, LinkKey, fault_of
from protocol.datagram import Datagram, decode
from protocol.datagram_layout import FLAG_AUTHENTICATED, FLAG_ECHO_VALID, MAGIC
from protocol.errors import DatagramRefused
from protocol.pose import Pose
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    HeartbeatReply,
    Hello,
    State,
    StreamRefused,
    Welcome,
)

NOT_JUDGED, RIGHT = "not judged", "right"
_OF_THE_CONTROLLER = (Welcome, HeartbeatReply, Acknowledgement, State, StreamRefused)
_HIDDEN_IN_LINES = ("q_cmd", "X_BT_cmd", "lateness_p50_us", "lateness_p99_us", "lateness_max_us")


def is_ours(packet: UdpPacket, port: int) -> bool:
    """Whether it belongs to the reference link: by its magic, or by the controller's port (0: any)."""
    if port and port not in (packet.source[1], packet.destination[1]):
        return False
    return bool(port) or packet.data.startswith(MAGIC)


class TagReader:
    """What a receiver with ``key`` would say to tags; it learns the keys of sessions from WELCOME.

    Without a key tags are noted and not judged.
    """

    def __init__(self, key: LinkKey | None = None) -> None:
        self._key = key
        self._sessions: dict[int, ChannelKeys] = {}

    def said(self, data: bytes, datagram: Datagram) -> str | None:
        """None for a datagram without a tag, else "not judged", "right", or the cause of a refusal."""
        header, message = datagram
        if not header.flags & FLAG_AUTHENTICATED:
            return None
        if self._key is None:
            return NOT_JUDGED
        if isinstance(message, Hello):
            return fault_of(data, header.flags, self._key.of_hello()) or RIGHT
        if isinstance(message, Welcome):
            keys = self._key.of_client(message.client_nonce, header.session, message.boot_id)
            if fault_of(data, header.flags, keys.receives) is None:
                self._sessions[header.session] = keys
        known = self._sessions.get(header.session)
        if known is None:
            return NOT_JUDGED
        faults = [fault_of(data, header.flags, key) for key in _of_either_side(message, known)]
        return RIGHT if None in faults else faults[0]


def _of_either_side(message: object, keys: ChannelKeys) -> tuple[DirectionKey, ...]:
    if isinstance(message, Bye):
        return tuple(keys)
    return (keys.receives,) if isinstance(message, _OF_THE_CONTROLLER) else (keys.sends,)


def as_fields(packet: UdpPacket, tags: TagReader | None = None) -> dict[str, Any]:
    """The packet as plain data; a datagram that a receiver would drop has ``refused`` with the cause.

    ``tag`` is what ``tags`` (by default without a key) says to it.
    """
    fields: dict[str, Any] = {
        "time_s": packet.time_s,
        "source": f"{packet.source[0]}:{packet.source[1]}",
        "destination": f"{packet.destination[0]}:{packet.destination[1]}",
        "bytes": len(packet.data),
    }
    try:
        datagram = decode(packet.data)
    except DatagramRefused as refusal:
        return fields | {"refused": refusal.cause, "detail": str(refusal)}
    header, message = datagram
    tag = (tags or TagReader()).said(packet.data, datagram)
    if tag not in (None, NOT_JUDGED, RIGHT):
        return fields | {"refused": tag, "detail": f"{type(message).__name__} seq={header.sequence}: {tag}"}
    echo = header.echo_sequence if header.flags & FLAG_ECHO_VALID else None
    return fields | {
        "message": type(message).__name__,
        "session": f"{header.session:016x}",
        "sequence": header.sequence,
        "echo": echo,
        "sent_ns": header.sent_ns,
        "tag": tag,
        "fields": {name: _plain(value) for name, value in message._asdict().items()},
    }


def as_line(packet: UdpPacket, began_s: float, tags: TagReader | None = None) -> str:
    """The packet in one line; times since ``began_s``."""
    fields = as_fields(packet, tags)
    head = f"{packet.time_s - began_s:10.6f} {fields['source']} → {fields['destination']}"
    if "refused" in fields:
        return f"{head} {fields['bytes']} bytes refused: {fields['detail']}"
    said = " ".join(
        f"{name}={_short(value)}" for name, value in fields["fields"].items() if name not in _HIDDEN_IN_LINES
    )
    echo = "" if fields["echo"] is None else f" echo={fields['echo']}"
    tag = "" if fields["tag"] is None else f" tag={fields['tag'].replace(' ', '-')}"
    return f"{head} {fields['message']} seq={fields['sequence']}{echo}{tag} {said}"


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


def sniff(
    pcap: Annotated[Path | None, typer.Option(help="Read this capture instead of an interface.")] = None,
    interface: Annotated[str, typer.Option(help="Listen here; needs CAP_NET_RAW.")] = "lo",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="The controller's port, unsound datagrams too; 0: by magic.")
    ] = 0,
    count: Annotated[int, typer.Option(min=0, help="End after so many datagrams; 0: never.")] = 0,
    key: Annotated[
        Path | None, typer.Option(help="File with the shared key: judge the tags of sessions seen to open.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json-lines", help="One JSON object a datagram.")] = False,
) -> None:
    """Print every datagram of the reference link, with the cause where a receiver would drop it."""
    packets = from_file(pcap) if pcap is not None else from_interface(interface)
    ours = (packet for packet in packets if is_ours(packet, port))
    tags = TagReader(None if key is None else key_from_file(key))
    began_s: float | None = None
    try:
        for packet in itertools.islice(ours, count or None):
            began_s = packet.time_s if began_s is None else began_s
            typer.echo(json.dumps(as_fields(packet, tags)) if as_json else as_line(packet, began_s, tags))
    except KeyboardInterrupt:
        return
