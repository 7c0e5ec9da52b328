"""One line for a person, or one object for a program, for each datagram of the reference link."""

import itertools
import json
import socket
import struct
import time
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import IO, Annotated, Any, NamedTuple

import typer

from foundation.secret_source import key_from_file
from protocol.authentication import ChannelKeys, DirectionKey, LinkKey, fault_of
from protocol.datagram import Datagram, decode
from protocol.datagram_layout import FLAG_AUTHENTICATED, FLAG_ECHO_VALID, MAGIC
from protocol.errors import ConfigurationError, DatagramRefused
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

_ETHERNET, _RAW_IP, _RAW_IPV4, _LINUX_SLL, _LINUX_SLL2, _NULL = 1, 101, 228, 113, 276, 0
_IPV4, _VLAN, _UDP = 0x0800, 0x8100, 17
_ALL_PROTOCOLS = 3
_LINK_BYTES = {_ETHERNET: 14, _RAW_IP: 0, _RAW_IPV4: 0, _LINUX_SLL: 16, _LINUX_SLL2: 20, _NULL: 4}
_KIND_AT = {_ETHERNET: 12, _LINUX_SLL: 14, _LINUX_SLL2: 0}  # where the protocol behind the header is told
_MAGICS = {b"\xd4\xc3\xb2\xa1": ("<", 1e-6), b"\xa1\xb2\xc3\xd4": (">", 1e-6),
           b"\x4d\x3c\xb2\xa1": ("<", 1e-9), b"\xa1\xb2\x3c\x4d": (">", 1e-9)}  # fmt: skip


class UdpPacket(NamedTuple):
    """One datagram seen on the wire; ``time_s`` since 1970."""

    time_s: float
    source: tuple[str, int]
    destination: tuple[str, int]
    data: bytes


def from_file(path: Path) -> Iterator[UdpPacket]:
    """The UDP datagrams over IPv4 of a classic pcap file, in its order; fragments are passed over.

    Raises ConfigurationError when it cannot be read (``sniff.unreadable``) or is no such file
    (``sniff.not_pcap``). A file that was cut off ends with its last whole packet.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigurationError("sniff.unreadable", f"{path}: {error.strerror}") from error
    order_and_tick = _MAGICS.get(content[:4])
    if order_and_tick is None or len(content) < 24:
        raise ConfigurationError(
            "sniff.not_pcap", f"{path}: no pcap file (pcapng: editcap -F pcap converts it)"
        )
    order, tick_s = order_and_tick
    link = struct.unpack_from(order + "I", content, 20)[0] & 0xFFFF
    if link not in _LINK_BYTES:
        known = ", ".join(map(str, sorted(_LINK_BYTES)))
        why = f"link type {link} is not known here, {known} are: capture on one Ethernet interface, or -i any"
        raise ConfigurationError("sniff.not_pcap", f"{path}: {why}")
    at = 24
    while at + 16 <= len(content):
        seconds, fraction, size, _ = struct.unpack_from(order + "4I", content, at)
        at += 16
        if at + size > len(content):
            return
        packet = _udp(content[at : at + size], link, seconds + fraction * tick_s)
        if packet is not None:
            yield packet
        at += size


def from_interface(name: str) -> Iterator[UdpPacket]:
    """The UDP datagrams over IPv4 that pass an interface, without end. Needs CAP_NET_RAW.

    Raises ConfigurationError (``sniff.interface``).
    """
    try:
        tap = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL_PROTOCOLS))
        tap.bind((name, 0))
    except OSError as error:
        raise ConfigurationError("sniff.interface", f"--interface {name}: {error.strerror}") from error
    with tap:
        while True:
            frame, address = tap.recvfrom(65_535)
            if name == "lo" and address[2] == socket.PACKET_OUTGOING:
                continue  # the loopback shows every packet twice
            packet = _udp(frame, _ETHERNET, time.time())
            if packet is not None:
                yield packet


def _udp(frame: bytes, link: int, time_s: float) -> UdpPacket | None:
    at = _LINK_BYTES[link]
    if link in _KIND_AT and len(frame) >= at:
        kind = int.from_bytes(frame[_KIND_AT[link] :][:2], "big")
        if kind == _VLAN and len(frame) >= at + 4:
            kind, at = int.from_bytes(frame[at + 2 : at + 4], "big"), at + 4
        if kind != _IPV4:
            return None
    ip = frame[at:]
    if len(ip) < 20 or ip[0] >> 4 != 4 or ip[9] != _UDP or int.from_bytes(ip[6:8], "big") & 0x3FFF:
        return None
    begin = 4 * (ip[0] & 0x0F)
    if len(ip) < begin + 8:
        return None
    source_port, port, size = struct.unpack_from(">3H", ip, begin)
    source, destination = socket.inet_ntoa(ip[12:16]), socket.inet_ntoa(ip[16:20])
    return UdpPacket(time_s, (source, source_port), (destination, port), ip[begin + 8 : begin + max(size, 8)])


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


def as_pcap(packet: UdpPacket) -> bytes:
    """The packet as a record of a pcap file of raw IPv4 (link type 101), with checksums of zero."""
    size = 8 + len(packet.data)
    udp = struct.pack(">4H", packet.source[1], packet.destination[1], size, 0) + packet.data
    ends = (socket.inet_aton(host) for host, _ in (packet.source, packet.destination))
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + size, 0, 0, 64, _UDP, 0, *ends) + udp
    seconds, rest = divmod(round(packet.time_s * 1e6), 1_000_000)
    return struct.pack("<4I", seconds, rest, len(ip), len(ip)) + ip


PCAP_HEAD = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, _RAW_IP)


def _opened(path: Path | None) -> IO[bytes] | None:
    if path is None:
        return None
    try:
        made = path.open("xb", buffering=0)
    except OSError as error:
        raise ConfigurationError("sniff.not_written", f"--out {path}: {error.strerror}") from error
    made.write(PCAP_HEAD)
    return made


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
    out: Annotated[
        Path | None, typer.Option(help="Also write them as a capture for Wireshark; made, never overwritten.")
    ] = None,
) -> None:
    """Print every datagram of the reference link, with the cause where a receiver would drop it."""
    packets = from_file(pcap) if pcap is not None else from_interface(interface)
    ours = (packet for packet in packets if is_ours(packet, port))
    tags = TagReader(None if key is None else key_from_file(key))
    began_s: float | None = None
    written = _opened(out)
    try:
        for packet in itertools.islice(ours, count or None):
            if written is not None:
                written.write(as_pcap(packet))
            began_s = packet.time_s if began_s is None else began_s
            typer.echo(json.dumps(as_fields(packet, tags)) if as_json else as_line(packet, began_s, tags))
    except KeyboardInterrupt:
        return
    finally:
        if written is not None:
            written.close()
