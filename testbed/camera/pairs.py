"""Pairs as a camera takes them, from wherever they are: a recording, pictures, a film, a device, the running
plant.
"""

import asyncio
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from protocol.errors import ConfigurationError, LinkLost
from vision_pc.config.camera import CameraSettings
from vision_pc.config.choices import Detector
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras import open_camera
from vision_pc.shell.cameras.directory import TABLE, read_grey, recorded_pairs
from vision_pc.shell.cameras.uvc import halves

_PICTURES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")
LIVE = "live"


class Taken(NamedTuple):
    """Pairs with their names; ``stamped``: their capture times come from the camera or its recording."""

    names: list[str]
    pairs: list[StereoPair]
    stamped: bool


def take(source: str, settings: CameraSettings, most: int) -> Taken:
    """At most ``most`` pairs of ``source``: ``live`` (as configured), a device's number, a film, or a
    directory.

    A directory holds ``captures.csv``, or ``left`` and ``right`` with as many pictures each, or pictures
    named ``left…`` and ``right…``. Raises ConfigurationError, FrameRefused and LinkLost.
    """
    if source == LIVE or source.isdigit():
        device = settings if source == LIVE else settings.model_copy(update={
            "source": "uvc", "uvc": settings.uvc.model_copy(update={"device": int(source)})})  # fmt: skip
        pairs = asyncio.run(_live(device, most))
        return Taken([f"frame {pair.frame_id}" for pair in pairs], pairs, True)
    path = Path(source)
    if (path / TABLE).is_file():
        pairs = _spread(list(recorded_pairs(path)), most)
        return Taken([f"frame {pair.frame_id}" for pair in pairs], pairs, True)
    if path.is_dir():
        return _pictures(path, most)
    if not path.exists():
        raise ConfigurationError("configuration.no_recording", f"{path}: no such directory, film or device")
    pairs = _film(path, most)
    return Taken([f"picture {pair.frame_id}" for pair in pairs], pairs, False)


def _spread(pairs: list[StereoPair], most: int) -> list[StereoPair]:
    """At most ``most`` of them, evenly over all."""
    if len(pairs) <= most:
        return pairs
    return [pairs[k] for k in np.linspace(0, len(pairs) - 1, most).round().astype(int)]


def _pictures(directory: Path, most: int) -> Taken:
    folders = (directory / "left", directory / "right")
    if all(folder.is_dir() for folder in folders):
        names = [sorted(p for p in folder.iterdir() if p.suffix.lower() in _PICTURES) for folder in folders]
    else:
        every = sorted(p for p in directory.iterdir() if p.suffix.lower() in _PICTURES)
        names = [[p for p in every if p.name.lower().startswith(eye)] for eye in ("left", "right")]
    left, right = names
    if not left or len(left) != len(right):
        raise ConfigurationError(
            "configuration.bad_recording",
            f"{directory}: {len(left)} pictures of the left eye and {len(right)} of the right one; wanted "
            f"are {TABLE}, or folders left and right, or files left… and right…, as many of each",
        )
    chosen = np.linspace(0, len(left) - 1, min(most, len(left))).round().astype(int)
    pairs = [StereoPair(read_grey(left[k]), read_grey(right[k]), 0, int(k)) for k in chosen]
    return Taken([left[k].name for k in chosen], pairs, False)


def _film(path: Path, most: int) -> list[StereoPair]:
    film = cv2.VideoCapture(str(path))
    try:
        if not film.isOpened():
            raise ConfigurationError("configuration.bad_recording", f"{path}: no film that can be decoded")
        return _spread(list(_decoded(film, str(path))), most)
    finally:
        film.release()


def _decoded(film: cv2.VideoCapture, path: str) -> Iterator[StereoPair]:
    number = 0
    while True:
        taken, picture = film.read()
        if not taken:
            return
        number += 1
        left, right = halves(np.asarray(picture, dtype=np.uint8), path)
        yield StereoPair(left, right, 0, number)


async def _live(settings: CameraSettings, most: int) -> list[StereoPair]:
    camera = open_camera(settings)
    await camera.start()
    found: list[StereoPair] = []
    try:
        with contextlib.suppress(LinkLost) if found else contextlib.nullcontext():
            async for pair in camera.pairs():
                found.append(pair._replace(left=pair.left.copy(), right=pair.right.copy()))
                if len(found) >= most:
                    break
    finally:
        await camera.close()
    return found


AskedBoard = Checkerboard | Charuco


def found_board(pair: StereoPair, board: AskedBoard, name: str) -> PairView:
    """The corners of ``board`` that both eyes see. Raises MeasurementFailed when one of them does not see
    it.
    """
    views = [
        zhang.find_charuco(picture, board, name)
        if isinstance(board, Charuco)
        else zhang.find_checkerboard(picture, board, Detector.SECTORS, name)
        for picture in (pair.left, pair.right)
    ]
    return stereo_fit.paired(views[0], views[1])
