"""Datagrams bent on purpose."""

import struct
from zlib import crc32

from protocol.authentication import DirectionKey
from protocol.datagram_layout import CRC_BYTES, CRC_OFFSET, HEADER_BYTES, TAG_BYTES, TRAILER_BYTES

LENGTH = 10
_AFTER_CRC = CRC_OFFSET + CRC_BYTES


def resealed(data: bytes, key: DirectionKey | None = None) -> bytes:
    """``data`` with its CRC, and with a ``key`` its tag, made right, to reach the checks behind them."""
    if key is not None and len(data) >= HEADER_BYTES + TRAILER_BYTES:
        data = data[:-TAG_BYTES] + key.tag(data[:-TAG_BYTES])
    checksum = crc32(data[_AFTER_CRC:], crc32(data[:CRC_OFFSET]))
    return data[:CRC_OFFSET] + struct.pack("<I", checksum) + data[_AFTER_CRC:]


def with_number(data: bytes, offset: int, code: str, value: float, key: DirectionKey | None = None) -> bytes:
    """``data`` with one number replaced and its CRC and tag made right."""
    bent = bytearray(data)
    struct.pack_into("<" + code, bent, offset, value)
    return resealed(bytes(bent), key)


def with_payload_of(data: bytes, size: int, key: DirectionKey | None = None) -> bytes:
    """``data`` with a payload of ``size`` bytes, cut or filled up with zeros, and all else made to match."""
    end = len(data) - (TRAILER_BYTES if key else 0)
    payload, trailer = data[HEADER_BYTES:end], data[end:]
    resized = data[:HEADER_BYTES] + payload[:size].ljust(size, b"\0") + trailer
    return with_number(resized, LENGTH, "H", size, key)


def with_bit_flipped(data: bytes, bit: int) -> bytes:
    """``data`` with one bit flipped and nothing else."""
    bent = bytearray(data)
    bent[bit // 8] ^= 1 << bit % 8
    return bytes(bent)
