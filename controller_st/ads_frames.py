"""AMS frames over TCP: cut from a stream, and packed. Beckhoff, TE1000: AMS/TCP header, AMS header."""

import struct
from enum import IntEnum
from typing import NamedTuple

from protocol.errors import LongreachError

MAX_FRAME = 256 * 1024
"""Bytes behind the AMS/TCP header of a frame that is taken or sent at most."""

_TCP = struct.Struct("<HI")
_AMS = struct.Struct("<6sH6sHHHIII")
_RESPONSE, ADS_COMMAND = 1, 4


class AdsError(IntEnum):
    """Return codes that are given."""

    NONE = 0
    PORT_NOT_FOUND = 0x6
    SERVICE_NOT_SUPPORTED = 0x701
    INVALID_GROUP = 0x702
    INVALID_OFFSET = 0x703
    INVALID_ACCESS = 0x704
    INVALID_SIZE = 0x705
    INVALID_DATA = 0x706
    NO_MEMORY = 0x70A
    SYMBOL_NOT_FOUND = 0x710
    INVALID_NOTIFICATION = 0x714


class AdsCommand(IntEnum):
    """Commands that are known."""

    DEVICE_INFO = 1
    READ = 2
    WRITE = 3
    READ_STATE = 4
    WRITE_CONTROL = 5
    ADD_NOTIFICATION = 6
    DELETE_NOTIFICATION = 7
    NOTIFICATION = 8
    READ_WRITE = 9


class StreamBroken(LongreachError):
    """What came is no stream of AMS frames, or one longer than is taken: the connection has to end."""


class AmsAddress(NamedTuple):
    """Six bytes, and a port."""

    net_id: bytes
    port: int


class AmsFrame(NamedTuple):
    """One command or its answer; ``error`` is the router's, 0 in a command."""

    target: AmsAddress
    source: AmsAddress
    command: int
    flags: int
    error: int
    invoke_id: int
    data: bytes

    @property
    def is_request(self) -> bool:
        """Whether it asks: an answer is never answered."""
        return self.flags & (_RESPONSE | ADS_COMMAND) == ADS_COMMAND

    def answered(self, data: bytes, error: int = 0) -> "AmsFrame":
        """The answer to it."""
        flags = _RESPONSE | ADS_COMMAND
        return AmsFrame(self.source, self.target, self.command, flags, error, self.invoke_id, data)

    @property
    def packed(self) -> bytes:
        """Its bytes with both headers."""
        to, by = self.target, self.source
        head = _AMS.pack(
            *to, *by, self.command, self.flags, len(self.data), self.error, self.invoke_id
        )  # fmt: skip
        return _TCP.pack(0, len(head) + len(self.data)) + head + self.data


def cut(stream: bytearray) -> AmsFrame | None:
    """The first whole frame of ``stream``, taken out of it; None: it is not all there yet.

    Raises StreamBroken (``ads.not_ams``, ``ads.frame_too_long``).
    """
    if len(stream) < _TCP.size:
        return None
    kind, length = _TCP.unpack_from(stream)
    if kind != 0 or length < _AMS.size:
        raise StreamBroken("ads.not_ams", f"an AMS/TCP header of kind {kind} and length {length} came")
    if length > MAX_FRAME:
        raise StreamBroken("ads.frame_too_long", f"a frame of {length} bytes came, {MAX_FRAME} at most")
    end = _TCP.size + length
    if len(stream) < end:
        return None
    to_id, to_port, by_id, by_port, command, flags, size, error, invoke_id = _AMS.unpack_from(
        stream, _TCP.size
    )
    data = bytes(memoryview(stream)[_TCP.size + _AMS.size : end])
    del stream[:end]
    if size != len(data):
        raise StreamBroken("ads.not_ams", f"an AMS header says {size} bytes of data, {len(data)} came")
    return AmsFrame(
        AmsAddress(to_id, to_port), AmsAddress(by_id, by_port), command, flags, error, invoke_id, data
    )
