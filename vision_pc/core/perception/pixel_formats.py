"""Pixels of industrial cameras as grey levels, by their codes in GenICam's Pixel Format Naming Convention."""

import cv2
import numpy as np

from protocol.errors import FrameRefused
from vision_pc.core.types import Image

# OpenCV names a mosaic by its second row, from the second column on; GenICam by its first.
MOSAIC_TO_GREY = {
    "RG": cv2.COLOR_BayerBG2GRAY,
    "GR": cv2.COLOR_BayerGB2GRAY,
    "GB": cv2.COLOR_BayerGR2GRAY,
    "BG": cv2.COLOR_BayerRG2GRAY,
}
"""The first row of a mosaic's colours → OpenCV's code."""
_MOSAICS = {0x01080008: "GR", 0x01080009: "RG", 0x0108000A: "GB", 0x0108000B: "BG"}
_MONO8, _MONO10, _MONO10P, _MONO12 = 0x01080001, 0x01100003, 0x010A0046, 0x01100005
_NAMES = ("Mono8", "Mono10", "Mono10p", "Mono12", *(f"Bayer{row}8" for row in _MOSAICS.values()))


def grey_levels(data: bytes, width: int, height: int, pixel_format: int, source: str) -> Image:
    """The picture (height, width) uint8; of more than 8 bits the upper ones.

    Raises FrameRefused: ``frame.wrong_pixels`` for another format, ``frame.wrong_size`` where bytes lack.
    """
    count = width * height
    if pixel_format == _MONO8 or pixel_format in _MOSAICS:
        raw = _taken(data, count, np.uint8, source)
        picture = raw.reshape(height, width)
        if pixel_format == _MONO8:
            return picture.copy()
        return np.asarray(cv2.cvtColor(picture, MOSAIC_TO_GREY[_MOSAICS[pixel_format]]), dtype=np.uint8)
    if pixel_format in (_MONO10, _MONO12):
        shift = 2 if pixel_format == _MONO10 else 4
        return (_taken(data, count, np.dtype("<u2"), source) >> shift).astype(np.uint8).reshape(height, width)
    if pixel_format == _MONO10P:
        return _unpacked(data, count, source).reshape(height, width)
    why = f"{source}: pixels of format {pixel_format:#010x} came; known are {', '.join(_NAMES)}"
    raise FrameRefused("frame.wrong_pixels", why)


def _taken(data: bytes, count: int, dtype: "np.dtype[np.uint16] | type[np.uint8]", source: str) -> Image:
    size = np.dtype(dtype).itemsize
    if len(data) < count * size:
        why = f"{source}: {len(data)} bytes came, {count * size} make a picture"
        raise FrameRefused("frame.wrong_size", why)
    return np.frombuffer(data, dtype, count)


def _unpacked(data: bytes, count: int, source: str) -> Image:
    """Four pixels in five bytes, the lowest bits first; the upper eight bits of each."""
    groups = -(-count // 4)
    raw = _taken(data, 5 * groups, np.uint8, source).reshape(groups, 5).astype(np.uint16)
    words = raw[:, :4] | (raw[:, 1:] << 8)
    pixels = (words >> np.array([2, 4, 6, 8], dtype=np.uint16)) & 0xFF
    return pixels.astype(np.uint8).ravel()[:count]
