"""Header of one stereo frame on the camera stream; after it left, then right image, mono8, row by row."""

import struct
from typing import NamedTuple
from zlib import crc32

from protocol.errors import FrameRefused, RequestRefused

MAGIC = b"LRSF"
VERSION = 1
MAX_SIDE_PIXELS = 4096

# magic, version, header length, frame id, capture and send time, width, height, exposure, flags, CRC-32
_LAYOUT = struct.Struct("<4sHHQQQIIIII")
_CRC = struct.Struct("<I")
HEADER_BYTES = _LAYOUT.size
_COVERED = HEADER_BYTES - _CRC.size


class FrameHeader(NamedTuple):
    """One stereo pair. Times are on the camera's own monotonic clock; ``capture_ns`` is mid-exposure."""

    frame_id: int
    capture_ns: int
    send_ns: int
    width: int
    height: int
    exposure_us: int
    flags: int

    @property
    def payload_bytes(self) -> int:
        """Length of the pixels that follow the header: two mono8 images."""
        return 2 * self.width * self.height


def encode_header(header: FrameHeader) -> bytes:
    """The HEADER_BYTES bytes of ``header``.

    Raises RequestRefused (``refused.not_encodable``) when a field does not fit.
    """
    try:
        _check_size(header)
        packed = _LAYOUT.pack(MAGIC, VERSION, HEADER_BYTES, *header, 0)
    except (struct.error, FrameRefused) as error:
        raise RequestRefused("refused.not_encodable", f"{header}: {error}") from error
    return packed[:_COVERED] + _CRC.pack(crc32(packed[:_COVERED]))


def decode_header(data: bytes) -> FrameHeader:
    """The header in exactly HEADER_BYTES bytes.

    Raises FrameRefused: a stream that has lost its place cannot be found again, the receiver reconnects.
    """
    if len(data) != HEADER_BYTES:
        raise FrameRefused("frame.bad_length", f"{len(data)} bytes: a frame header has {HEADER_BYTES}")
    magic, version, header_bytes, *values, checksum = _LAYOUT.unpack(data)
    if magic != MAGIC:
        raise FrameRefused("frame.bad_magic", f"magic {magic.hex()}: wanted {MAGIC.hex()}")
    if version != VERSION:
        raise FrameRefused("frame.wrong_version", f"version {version}: this side speaks {VERSION}")
    if header_bytes != HEADER_BYTES:
        raise FrameRefused("frame.bad_length", f"header says {header_bytes} bytes: wanted {HEADER_BYTES}")
    if checksum != crc32(data[:_COVERED]):
        raise FrameRefused("frame.bad_crc", f"CRC-32 {checksum:08x} does not match the header")
    header = FrameHeader(*values)
    _check_size(header)
    return header


def _check_size(header: FrameHeader) -> None:
    if not (1 <= header.width <= MAX_SIDE_PIXELS and 1 <= header.height <= MAX_SIDE_PIXELS):
        raise FrameRefused(
            "frame.bad_size", f"{header.width}×{header.height} pixels: wanted 1…{MAX_SIDE_PIXELS} a side"
        )
