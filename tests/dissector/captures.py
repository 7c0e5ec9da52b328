"""Captures made by hand: datagrams in UDP in IPv4 in Ethernet, as a pcap file."""

import struct
from pathlib import Path


def frame(data: bytes, source_port: int, port: int) -> bytes:
    """One Ethernet frame from 10.0.0.1 to 10.0.0.2."""
    udp = struct.pack(">4H", source_port, port, 8 + len(data), 0) + data
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), 1, 0, 64, 17, 0, bytes((10, 0, 0, 1)),
                     bytes((10, 0, 0, 2)))  # fmt: skip
    return b"\x02" * 6 + b"\x04" * 6 + b"\x08\x00" + ip + udp


def write_pcap(path: Path, datagrams: list[bytes], source_port: int = 5000, port: int = 47_000) -> None:
    """Writes a classic pcap file with one datagram a millisecond."""
    content = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1)
    for index, data in enumerate(datagrams):
        framed = frame(data, source_port, port)
        content += struct.pack("<4I", 100, 1000 * index, len(framed), len(framed)) + framed
    path.write_bytes(content)
