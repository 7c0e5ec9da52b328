"""Pictures in files as grey levels, one or a pair."""

from pathlib import Path

import cv2
import numpy as np

from protocol.errors import ConfigurationError
from vision_pc.core.types import Image, StereoPair

_GREY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
# [S] TIFF 6.0, section 8, and EXIF: the entry of orientation in either order of bytes; its value follows.
_TURN = (b"\x12\x01\x03\0\x01\0\0\0", b"\x01\x12\0\x03\0\0\0\x01\0")
_SEEN_THROUGH = (3, 4, 6)  # [S] PNG's colour types with an alpha channel, or a palette that may have one
_TIFF = (b"II*\0", b"MM\0*")  # [S] TIFF 6.0, section 2


def read_pair(left: Path, right: Path, capture_ns: int, frame_id: int) -> StereoPair:
    """The pictures of both eyes. Raises ConfigurationError as ``read_grey``, or where they differ in size."""
    pictures = read_grey(left), read_grey(right)
    if pictures[0].shape != pictures[1].shape:
        raise ConfigurationError("configuration.bad_recording", f"{left} and {right} differ in size")
    return StereoPair(*pictures, capture_ns, frame_id)


def read_grey(path: Path) -> Image:
    """The picture in ``path``, (height, width) uint8; a transparent one lies on white. Of more bits than
    eight, the upper eight of as many (8, 10, … 16) as its greatest value has, wherever a container has more.
    Raises ConfigurationError when there is none, or one that its file wants to be shown turned, or several.
    """
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise ConfigurationError("configuration.bad_recording", f"{path}: {error.strerror}") from error
    picture = cv2.imdecode(data, _GREY) if data.size else None
    if picture is None or picture.dtype not in (np.uint8, np.uint16):
        why = "no picture, or one cut short" if data.size else "no picture: the file is empty"
        if picture is not None or data[:4].tobytes() in _TIFF:
            why = "grey levels of 8 or 16 bits are wanted, whole numbers without sign; or it is cut short"
        raise ConfigurationError("configuration.bad_recording", f"{path}: {why}")
    _refuse_turned_or_several(path, data.tobytes())
    if picture.dtype == np.uint16:
        bits = int(picture.max()).bit_length()
        picture = np.right_shift(picture.astype(np.uint16), max(bits + bits % 2 - 8, 0)).astype(np.uint8)
    kind = int(data[25]) if data[:4].tobytes() == b"\x89PNG" and len(data) > 25 else 0
    layers = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if kind in _SEEN_THROUGH else None
    if layers is None or layers.ndim < 3 or layers.shape[2] != 4:
        return np.asarray(picture, dtype=np.uint8)
    share = layers[..., 3] / layers[..., 3].max() if layers[..., 3].any() else 1.0  # else there is no picture
    return np.asarray(np.round(share * picture + (1.0 - share) * 255.0), dtype=np.uint8)


def _refuse_turned_or_several(path: Path, data: bytes) -> None:
    """Calibrations are of the sensor's rows, which EXIF or TIFF may turn; of pages the first is read."""
    pages = cv2.imcount(str(path)) if data[:4] in _TIFF else 1
    turns = [data[at + len(mark) :][:1] for mark in _TURN if (at := data.find(mark)) >= 0]
    if any(b"\x01" < turn <= b"\x08" for turn in turns):
        why = "EXIF or TIFF has it shown turned: save it as the sensor saw it, without orientation"
    elif pages > 1:
        why = f"{pages} pictures in one file: save each one by itself"
    else:
        return
    raise ConfigurationError("configuration.bad_recording", f"{path}: {why}")
