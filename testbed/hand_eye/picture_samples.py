"""Pairs of hand and eye from pictures of a board: its views, and the poses beside them."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from rich.table import Table

from foundation.foreign_text import parse_json
from protocol.errors import MeasurementFailed, RequestRefused
from testbed.camera.checking import question
from testbed.hand_eye.importer import FORMAT
from testbed.hand_eye.pose_text import RobotPoses, file_text, numbers
from testbed.reporting.console import Columns, listed, out
from vision_pc.config.camera_files.reading import read_eye
from vision_pc.config.choices import Detector, LensModel, Setup
from vision_pc.core.hand_eye.solvers.lens import checked
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.board_finder import find_board, second_finders
from vision_pc.core.perception.rectification import RawLens
from vision_pc.core.perception.zhang_intrinsics import BoardView, Charuco, Checkerboard, Intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image
from vision_pc.shell.cameras.directory import read_grey


class IntrinsicsRow(NamedTuple):
    """One detector on one set of pictures; ``std_fx_px`` is the fit's word.

    ``outlying`` names views whose error stands out, ``empty_cells_percent`` the part of the picture without
    corners.
    """

    pictures: str
    detector: str
    views: int
    missed: tuple[str, ...]
    rms_px: float
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    std_fx_px: float
    outlying: tuple[str, ...]
    empty_cells_percent: float


def detect(
    pictures: Sequence[tuple[str, Image]],
    board: Checkerboard | Charuco,
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


def intrinsics_row(pictures: str, detector: str, found: Intrinsics, missed: tuple[str, ...]) -> IntrinsicsRow:
    """One line of the table."""
    K = found.K
    return IntrinsicsRow(
        pictures,
        detector,
        len(found.names),
        missed,
        found.rms_px,
        float(K[0, 0]),
        float(K[1, 1]),
        float(K[0, 2]),
        float(K[1, 2]),
        float(found.std_px[0]),
        found.outlying,
        100.0 * float((found.coverage == 0).mean()),
    )


def intrinsics_table(rows: Iterable[IntrinsicsRow]) -> Table:
    """The figures of each."""
    columns: Columns = {
        "pictures": "{pictures}",
        "corners by": "{detector}",
        "views": "{views}",
        "rms px": "{rms_px:.3f}",
        "fx": "{fx_px:.2f}",
        "± px": "{std_fx_px:.2f}",
        "outlying": lambda r: " ".join(r.outlying) or "–",
        "empty": "{empty_cells_percent:.0f} %",
    }
    return listed("intrinsics by Zhang's method", columns, rows)


_LEAST = 3


class CameraFile(NamedTuple):
    """A camera's lens as Brown-Conrady; ``covariance`` is None where the file has none, as is ``size``
    (width, height) px. ``bends``: another model's lens, whose corners are straightened first.
    """

    K: Array
    distortion: Array
    covariance: Array | None
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
        return _read_intrinsics(path)
    eye = read_eye(path, size)
    if eye.lens is not LensModel.BROWN_CONRADY:
        raw = RawLens(eye.K, np.array(eye.distortion), eye.lens is LensModel.FISHEYE)
        return CameraFile(eye.K, np.zeros(5), None, eye.size, raw)
    distortion, of_left = np.array(eye.distortion), None
    if eye.covariance is not None:
        of_left = checked(eye.K, distortion, np.array(eye.covariance)[:9, :9]).covariance
    return CameraFile(eye.K, distortion, of_left, eye.size)


def _read_intrinsics(path: Path) -> CameraFile:
    try:
        data = parse_json(file_text(path))
    except ValueError as error:
        raise RequestRefused("refused.hand_eye.unreadable", f"{path.name}: not JSON: {error}") from error
    if not isinstance(data, dict) or not {"K", "distortion", "covariance"} <= set(data):
        raise RequestRefused(
            "refused.hand_eye.format",
            f"{path.name}: K, distortion, covariance of `hand-eye intrinsics` are wanted",
        )
    lens = checked(
        numbers(data["K"], 9, f"{path.name} K").reshape(3, 3),
        numbers(data["distortion"], 5, f"{path.name} distortion"),
        numbers(data["covariance"], 81, f"{path.name} covariance").reshape(9, 9),
    )
    return CameraFile(*lens, None)


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


def sample_file(
    pairs: list[tuple[Path, Array]], camera: CameraFile, board: Checkerboard | Charuco, setup: Setup
) -> tuple[dict[str, Any], list[str]]:
    """The content of the samples' file, and the names of pictures without a board.

    Raises RequestRefused (``refused.hand_eye.count``) where fewer than three boards are left, or
    ``refused.board.counts`` where the pictures show another one.
    """
    target = _points(board)
    samples, missed, views = [], [], []
    for path, X_BT in pairs:
        image = _picture(path, camera)
        try:
            view = find_board(image, board, path.name)
        except MeasurementFailed:
            missed.append(path.name)
            continue
        views.append(view)
        samples.append(
            _sample(view._replace(pixels=camera.straight(view.pixels)), path, X_BT, camera, target)
        )
    for line in second_finders(views):
        out.print(line, style="yellow", highlight=False, soft_wrap=True)
    question([read_grey(path) for path, _ in pairs], board, len(samples))
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
    if camera.covariance is not None:
        content["camera_covariance"] = camera.covariance.tolist()
    return content, missed


def _picture(path: Path, camera: CameraFile) -> Image:
    """Raises RequestRefused for another size than the camera's."""
    image = read_grey(path)
    if camera.size is not None and image.shape != camera.size[::-1]:
        raise RequestRefused(
            "refused.hand_eye.sizes",
            f"{path.name}: {image.shape[1]}x{image.shape[0]} px, the calibration is of "
            f"{camera.size[0]}x{camera.size[1]}",
        )
    return image


def _sample(view: BoardView, path: Path, X_BT: Array, camera: CameraFile, target: Array) -> dict[str, Any]:
    """A picture's entry."""
    seen = {
        tuple(np.round(point, 9)): pixel
        for point, pixel in zip(view.points_m, view.pixels.tolist(), strict=True)
    }
    return {
        "name": path.stem,
        "hand": X_BT.tolist(),
        "camera": _pose(view, camera).tolist(),
        "corners_px": [seen.get(tuple(np.round(point, 9))) for point in target],
    }


def _points(board: Checkerboard | Charuco) -> Array:
    if isinstance(board, Charuco):
        return np.asarray(zhang.charuco_board(board).getChessboardCorners(), dtype=np.float64)
    y, x = np.mgrid[0 : board.rows, 0 : board.columns]
    return board.square_m * np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(np.float64)


def _pose(view: BoardView, camera: CameraFile) -> Array:
    """The board in the camera (4, 4) by its corners."""
    points, pixels = view.points_m, view.pixels
    _, turn, place = cv2.solvePnP(points, pixels, camera.K, camera.distortion, flags=cv2.SOLVEPNP_IPPE)
    turn, place = cv2.solvePnPRefineLM(points, pixels, camera.K, camera.distortion, turn, place)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = cv2.Rodrigues(turn)[0], place.ravel()
    return X


def write_samples(content: dict[str, Any], missed: list[str], to: Path) -> None:
    """Write the file and say what was left out. Raises OSError."""
    if missed:
        out.print(f"no board in {', '.join(missed)}", style="yellow", highlight=False, soft_wrap=True)
    to.write_text(json.dumps(content, indent=1), encoding="utf-8")
    known = "with" if "camera_covariance" in content else "without"
    out.print(
        f"{to}: {len(content['samples'])} samples, {known} the camera's covariance",
        highlight=False,
        soft_wrap=True,
    )
