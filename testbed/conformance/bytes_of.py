"""Datagrams bent on purpose."""

import struct
from zlib import crc32

CRC = 12


def resealed(data: bytes) -> bytes:
    """``data`` with its CRC made right, to reach the checks behind it."""
    checksum = crc32(data[CRC + 4 :], crc32(data[:CRC]))
    return data[:CRC] + struct.pack("<I", checksum) + data[CRC + 4 :]


def with_number(data: bytes, offset: int, code: str, value: float) -> bytes:
    """``data`` with one number replaced and the CRC made right."""
    bent = bytearray(data)
    struct.pack_into("<" + code, bent, offset, value)
    return resealed(bytes(bent))


def with_bit_flipped(data: bytes, bit: int) -> bytes:
    """``data`` with one bit flipped and nothing else."""
    bent = bytearray(data)
    bent[bit // 8] ^= 1 << bit % 8
    return bytes(bent)
