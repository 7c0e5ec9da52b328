"""Pairs of hand and eye from pictures of a board: its views, and the poses beside them."""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from foundation.foreign_text import parse_json, read_each
from protocol.errors import MeasurementFailed, RequestRefused
from testbed.camera.checking import question
from testbed.hand_eye.importer import FORMAT
from testbed.hand_eye.pose_text import RobotPoses, file_text
from testbed.reporting.console import noted, out
from vision_pc.config.camera_files.parts import Entries, Pinhole, believed
from vision_pc.config.camera_files.reading import read_eye
from vision_pc.config.choices import Detector, LensModel, Setup
from vision_pc.core import se3
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.april_grid import AprilGrid, Board
from vision_pc.core.perception.board_finder import find_board, second_finders
from vision_pc.core.perception.rectification import RawLens
from vision_pc.core.perception.zhang_intrinsics import BoardView
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image
from vision_pc.shell.cameras.grey_files import read_grey


def detect(
    pictures: Sequence[tuple[str, Image]],
    board: Board,
    detector: Detector = Detector.SECTORS,
) -> tuple[list[BoardView], tuple[str, ...]]:
    """The views in which the board was found, and the names of the others."""
    views, missed = [], []
    for name, image in pictures:
        try:
            views.append(find_board(image, board, name, detector))
        except MeasurementFailed:
            missed.append(name)
    return views, tuple(missed)


_LEAST = 3


class CameraFile(NamedTuple):
    """A camera's lens as Brown-Conrady; ``size`` (width, height) px is None where the file has none.
    ``bends``: another model's lens, whose corners are straightened first.
    """

    K: Array
    distortion: Array
    size: tuple[int, int] | None
    bends: RawLens | None = None

    def straight(self, pixels: Array) -> Array:
        """``pixels`` (n, 2) as a camera with ``K`` and ``distortion`` has them."""
        if self.bends is None:
            return pixels
        return np.asarray(self.bends.undistorted(pixels) @ self.K[:2, :2].T + self.K[:2, 2])


def read_camera(path: Path, size: tuple[int, int]) -> CameraFile:
    """The left eye of a calibration file, one camera's, or the JSON of `hand-eye intrinsics`. Raises
    LongreachError.

    ``size`` (width, height) of the pictures chooses among a ZED's and stands in where a file has none.
    """
    if path.suffix.lower() == ".json":
        return _read_intrinsics(path, size)
    eye = read_eye(path, size)
    if eye.lens is LensModel.BROWN_CONRADY:
        return CameraFile(eye.K, np.array(eye.distortion), eye.size)
    raw = RawLens(eye.K, np.array(eye.distortion), eye.lens is LensModel.FISHEYE)
    return CameraFile(eye.K, np.zeros(5), eye.size, raw)


def _read_intrinsics(path: Path, size: tuple[int, int]) -> CameraFile:
    try:
        data = parse_json(file_text(path))
    except ValueError as error:
        raise RequestRefused("refused.hand_eye.unreadable", f"{path.name}: not JSON: {error}") from error
    if not isinstance(data, dict) or not {"K", "distortion"} <= set(data):
        why = f"{path.name}: K and distortion of `hand-eye intrinsics` are wanted"
        raise RequestRefused("refused.hand_eye.format", why)
    file, keys = Entries(path, data), ("width_px", "height_px")
    if set(keys) <= set(data):
        size = file.size(keys, [data[key] for key in keys])
    D = file.numbers("distortion", data["distortion"], 5)
    eye = believed(Pinhole(file.camera_matrix("K", data["K"]), LensModel.BROWN_CONRADY, D, size), path)
    return CameraFile(eye.K, np.array(D), size)


def matched(pictures: list[Path], poses: RobotPoses, where: str) -> list[tuple[Path, Array]]:
    """Each picture with its pose: by name where the poses have names, else in order.

    Raises RequestRefused naming what is left over on either side.
    """
    if poses.names is None:
        if len(pictures) != len(poses.X_BT):
            over = (
                f"; left over from {pictures[len(poses.X_BT)].name} on"
                if len(pictures) > len(poses.X_BT)
                else ""
            )
            raise RequestRefused(
                "refused.hand_eye.count",
                f"{where}: {len(poses.X_BT)} poses for {len(pictures)} pictures{over}",
            )
        return list(zip(pictures, poses.X_BT, strict=True))
    twice = sorted({name for name in poses.names if poses.names.count(name) > 1})
    by_name = dict(zip(poses.names, poses.X_BT, strict=True))
    keys = [path.name if path.name in by_name else path.stem for path in pictures]
    unposed = [path.name for path, key in zip(pictures, keys, strict=True) if key not in by_name]
    missing = sorted(set(poses.names) - set(keys))
    for names, what in ((twice, "named twice"), (unposed, "no pose for"), (missing, "no picture for")):
        if names:
            raise RequestRefused("refused.hand_eye.count", f"{where}: {what} {', '.join(names[:10])}")
    return [(path, by_name[key]) for path, key in zip(pictures, keys, strict=True)]


class PosedPicture(NamedTuple):
    """A picture with the hand's pose (4, 4) beside it."""

    path: Path
    image: Image
    X_BT: Array


def alike(pairs: list[tuple[Path, Array]]) -> tuple[list[PosedPicture], list[str]]:
    """The pictures that can be read and are of the size that most are of, and of the others why not.

    Raises ConfigurationError where none can be read.
    """
    read, notes = read_each(pairs, lambda pair: read_grey(pair[0]))
    pictures = [PosedPicture(path, image, X_BT) for (path, X_BT), image in read]
    (shape, _), *others = Counter(one.image.shape for one in pictures).most_common()
    if others:
        names = ", ".join(one.path.name for one in pictures if one.image.shape != shape)
        notes.append(f"left out, not of {shape[1]}x{shape[0]} px as most are: {names}")
    return [one for one in pictures if one.image.shape == shape], notes


def sample_file(
    pictures: list[PosedPicture], camera: CameraFile, board: Board, setup: Setup
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The content of the samples' file, and the names of pictures without a board; all are of one size.

    Raises RequestRefused (``refused.hand_eye.count``) where fewer than three boards are left, or
    ``refused.board.counts`` where the pictures show another one.
    """
    target = board.all_points_m() if isinstance(board, AprilGrid) else zhang.board_points(board)
    height, width = pictures[0].image.shape
    if camera.size not in (None, (width, height)):
        why = f"{width}x{height} px, the calibration is of {camera.size[0]}x{camera.size[1]}"
        raise RequestRefused("refused.hand_eye.sizes", f"{pictures[0].path.name}: {why}")
    posed = {one.path.name: one for one in pictures}
    views, missed = detect([(name, one.image) for name, one in posed.items()], board)
    samples = [_sample(view, posed[view.name], camera, target) for view in views]
    noted(second_finders(views))
    question([one.image for one in pictures], board, len(samples))
    if len(samples) < _LEAST:
        raise RequestRefused(
            "refused.hand_eye.count",
            f"{len(samples)} pictures show the board, 3 are needed; none in {', '.join(missed)}",
        )
    content: dict[str, Any] = {
        "format": FORMAT, "setup": setup.value, "length_unit": "m", "samples": samples,
        "target_points_m": target.tolist(), "camera_matrix": camera.K.tolist(),
        "distortion": camera.distortion.tolist(),
    }  # fmt: skip
    return content, missed


def _sample(view: BoardView, posed: PosedPicture, camera: CameraFile, target: Array) -> dict[str, Any]:
    """A picture's entry."""
    view = view._replace(pixels=camera.straight(view.pixels))
    seen = {
        tuple(np.round(point, 9)): pixel
        for point, pixel in zip(view.points_m, view.pixels.tolist(), strict=True)
    }
    return {
        "name": posed.path.stem,
        "hand": posed.X_BT.tolist(),
        "camera": _pose(view, camera).tolist(),
        "corners_px": [seen.get(tuple(np.round(point, 9))) for point in target],
    }


def _pose(view: BoardView, camera: CameraFile) -> Array:
    """The board in the camera (4, 4) by its corners."""
    points, pixels = view.points_m, view.pixels
    _, turn, place = cv2.solvePnP(points, pixels, camera.K, camera.distortion, flags=cv2.SOLVEPNP_IPPE)
    turn, place = cv2.solvePnPRefineLM(points, pixels, camera.K, camera.distortion, turn, place)
    return se3.transform(cv2.Rodrigues(turn)[0], place.ravel())


def write_samples(content: dict[str, Any], missed: Sequence[str], to: Path) -> None:
    """Write the file and say what was left out. Raises OSError."""
    noted([f"no board in {', '.join(missed)}"] if missed else [])
    to.write_text(json.dumps(content, indent=1), encoding="utf-8")
    out.print(f"{to}: {len(content['samples'])} samples", highlight=False, soft_wrap=True)
