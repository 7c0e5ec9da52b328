"""UDP payloads out of captured frames: from a pcap file, or from an interface as they pass."""

import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from protocol.errors import ConfigurationError

_ETHERNET, _RAW_IP, _LINUX_SLL, _NULL = 1, 101, 113, 0
_IPV4, _VLAN, _UDP = 0x0800, 0x8100, 17
_ALL_PROTOCOLS = 3
_LINK_BYTES = {_ETHERNET: 14, _RAW_IP: 0, _LINUX_SLL: 16, _NULL: 4}
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
        raise ConfigurationError("sniff.not_pcap", f"{path}: link type {link} is not known here")
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
    if link in (_ETHERNET, _LINUX_SLL) and len(frame) >= at:
        kind = int.from_bytes(frame[at - 2 : at], "big")
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
