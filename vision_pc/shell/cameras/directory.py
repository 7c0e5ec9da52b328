"""Recorded pairs: PNG pictures of both eyes in one directory, with a table of when they were taken."""

import csv
import time
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import ConfigurationError, FrameRefused
from vision_pc.application.annotate import png
from vision_pc.core.types import Image, StereoPair
from vision_pc.shell.cameras.source import CameraSource

TABLE = "captures.csv"
_COLUMNS = ["frame_id", "capture_ns", "left", "right"]
_GREY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
_EXIF_WITHIN = 1 << 16  # [S] bytes: in JPEG it fits into one segment before the picture
_TIFF = (b"II*\0", b"MM\0*")  # [S] TIFF 6.0, section 2


class RecordedPair(NamedTuple):
    """One row of the table: when a pair was taken and the files that hold it."""

    frame_id: int
    capture_ns: int
    left: Path
    right: Path


class PairRecorder:
    """Writes pairs into a directory that ``recorded`` and ``DirectoryCamera`` read."""

    def __init__(self, directory: Path) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self._directory = directory
        self._table = (directory / TABLE).open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._table)
        self._rows.writerow(_COLUMNS)

    def add(self, pair: StereoPair) -> None:
        """Write ``pair`` to the recording."""
        names = [f"{pair.frame_id:08d}_{eye}.png" for eye in ("left", "right")]
        for name, picture in zip(names, (pair.left, pair.right), strict=True):
            (self._directory / name).write_bytes(png(picture))
        self._rows.writerow([pair.frame_id, pair.capture_ns, *names])
        self._table.flush()

    def close(self) -> None:
        """Complete and close the table."""
        self._table.close()


def recorded(directory: Path) -> list[RecordedPair]:
    """The table of a recording, in order of time.

    Raises ConfigurationError when it is missing, empty or not such a table.
    """
    path = directory / TABLE
    try:
        with path.open(newline="", encoding="utf-8") as table:
            rows = list(csv.DictReader(table))
        entries = [
            RecordedPair(
                int(r["frame_id"]), int(r["capture_ns"]), directory / r["left"], directory / r["right"]
            )
            for r in rows
        ]
    except OSError as error:
        raise ConfigurationError("configuration.no_recording", f"{path}: {error.strerror}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigurationError(
            "configuration.bad_recording",
            f"{path}: columns {', '.join(_COLUMNS)} with numbers are wanted, not {error}",
        ) from error
    if not entries:
        raise ConfigurationError("configuration.bad_recording", f"{path}: 0 pairs, at least 1 is wanted")
    return sorted(entries, key=lambda entry: entry.capture_ns)


def recorded_pair(entry: RecordedPair) -> StereoPair:
    """The pictures of one row of the table. Raises ConfigurationError as ``read_grey``, or where they differ
    in size.
    """
    left, right = read_grey(entry.left), read_grey(entry.right)
    if left.shape != right.shape:
        why = f"{entry.left} and {entry.right} differ in size"
        raise ConfigurationError("configuration.bad_recording", why)
    return StereoPair(left, right, entry.capture_ns, entry.frame_id)


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
        raise ConfigurationError("configuration.bad_recording", f"{path}: {why}")
    _refuse_turned_or_several(path, data, picture)
    if picture.dtype == np.uint16:
        bits = int(picture.max()).bit_length()
        picture = np.right_shift(picture.astype(np.uint16), max(bits + bits % 2 - 8, 0)).astype(np.uint8)
    layers = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if _may_be_transparent(data) else None
    if layers is None or layers.ndim < 3 or layers.shape[2] != 4:
        return np.asarray(picture, dtype=np.uint8)
    share = layers[..., 3] / (255.0 if layers.dtype == np.uint8 else 65535.0)
    return np.asarray(np.round(share * picture + (1.0 - share) * 255.0), dtype=np.uint8)


def _refuse_turned_or_several(path: Path, data: NDArray[np.uint8], picture: NDArray[Any]) -> None:
    """Calibrations are of the sensor's rows, which EXIF may turn; of several pages the first was read."""
    exif = b"exif" in data[:_EXIF_WITHIN].tobytes().lower()
    pages = cv2.imcount(str(path)) if data[:4].tobytes() in _TIFF else 1
    seen = cv2.imdecode(data, _GREY | cv2.IMREAD_IGNORE_ORIENTATION) if exif else None
    if seen is not None and not np.array_equal(seen, picture):
        why = "EXIF has it shown turned: save it as the sensor saw it, without EXIF"
    elif pages > 1:
        why = f"{pages} pictures in one file: save each one by itself"
    else:
        return
    raise ConfigurationError("configuration.bad_recording", f"{path}: {why}")


def _may_be_transparent(png: NDArray[np.uint8]) -> bool:
    """Whether it is a PNG file whose colour type has an alpha channel, or a palette that may have one."""
    return png[:4].tobytes() == b"\x89PNG" and len(png) > 25 and int(png[25]) in (3, 4, 6)


class DirectoryCamera(CameraSource):
    """Plays a recording as if it happened now, once, ``speed`` times as fast (0: as fast as it can be
    read).
    """

    def _produce(self) -> None:
        settings = self._settings.directory
        try:
            entries = recorded(settings.path)
            self._is_there()
            began_ns, first_ns = time.monotonic_ns(), entries[0].capture_ns
            for entry in entries:
                left, right = read_grey(entry.left), read_grey(entry.right)
                capture_ns = time.monotonic_ns()
                if settings.speed > 0.0:
                    capture_ns = began_ns + int((entry.capture_ns - first_ns) / settings.speed)
                    self._stop.wait(max(capture_ns - time.monotonic_ns(), 0) / 1e9)
                if self._stop.is_set():
                    return
                self._check_size(left, str(entry.left))
                self._check_size(right, str(entry.right))
                self._deliver(StereoPair(left, right, capture_ns, entry.frame_id))
            self._is_gone("link.recording_ended")
        except (ConfigurationError, FrameRefused) as error:
            self._is_gone(error.cause, str(error))
