"""`longreach camera calibrate` and `convert`: the one file that everything else reads."""

from pathlib import Path

import numpy as np

from protocol.errors import ConfigurationError, RequestRefused
from testbed.camera.checking import PLAIN, question
from testbed.camera.pairs import boards_in, take
from testbed.reporting.console import noted, out, table, write_json
from vision_pc.config.camera import CameraSettings
from vision_pc.config.camera_files.reading import read_calibrations, write_calibration
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import COEFFICIENTS, StereoCalibration
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception.april_grid import Board
from vision_pc.core.perception.rectification import RawLens, geometry, rectified_camera
from vision_pc.core.perception.stereo_fit import PairView, StereoFit
from vision_pc.core.se3 import Array

_ROWS_PX = 0.5  # [D] rms of the corners' rows after rectification, a quarter of what odometry takes


def run_calibrate(
    source: str,
    settings: CameraSettings,
    board: Board,
    lens: LensModel,
    most: int,
    to: Path,
    json_file: Path | None,
) -> bool:
    """Write the calibration to ``to``. Returns whether its rows fit; raises LongreachError where it is
    refused.
    """
    taken = take(source, settings.model_copy(update={"calibration": PLAIN}), most)
    height, width = taken.pairs[0].left.shape
    for name, pair in zip(taken.names, taken.pairs, strict=True):
        if {pair.left.shape, pair.right.shape} != {(height, width)}:
            why = f"{source}: {name} differs in size from {taken.names[0]}, {width}x{height}"
            raise RequestRefused("refused.camera.sizes", why)
    views, missed = boards_in(taken, board)
    noted([f"no board in both eyes: {', '.join(missed)}"] if missed else [])
    question([pair.left for pair in taken.pairs], board, len(views))
    if views:
        _guide(views, (width, height))
    found = stereo_fit.fit(views, (width, height), lens, f"{Path(source).name}, longreach camera calibrate")
    rows_px = rectified_rows(found.calibration, views)
    _write(to, found.calibration)
    _print(found, rows_px, to)
    write_json(json_file, {"fit": found._asdict() | {"calibration": found.calibration.model_dump()},
                           "rows_rms_px": rows_px, "missed": missed})  # fmt: skip
    return rows_px <= _ROWS_PX


def _guide(views: list[PairView], size: tuple[int, int]) -> None:
    """Say where the board was, and where to hold it next."""
    for name, counts in zip(("left", "right"), stereo_fit.covered(views, size), strict=True):
        empty = stereo_fit.empty_places(counts)
        gaps = f"still empty: {', '.join(empty)}" if empty else "every part of the picture is covered"
        out.print(f"{name} eye: board in {(counts > 0).mean():.0%} of the picture; {gaps}", highlight=False)


def rectified_rows(calibration: StereoCalibration, views: list[PairView]) -> float:
    """How far the rectified rows of the same corners are apart, rms px."""
    known = geometry(calibration)

    def rows(pixels: Array, lens: RawLens, R: Array) -> Array:
        rays = np.column_stack([lens.undistorted(pixels), np.ones(len(pixels))]) @ R.T
        return np.asarray(known.K[1, 1] * rays[:, 1] / rays[:, 2])

    apart = [
        rows(view.right, known.right, known.R_right) - rows(view.left, known.left, known.R_left)
        for view in views
    ]
    return float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))


def _print(found: StereoFit, rows_px: float, to: Path) -> None:
    calibration = found.calibration
    cells = [
        [name, *(f"{value:.6g}" for value in (eye.fx_px, eye.fy_px, eye.cx_px, eye.cy_px, *eye.distortion))]
        for name, eye in (("left", calibration.left), ("right", calibration.right))
    ]
    columns = ("eye", "fx px", "fy px", "cx px", "cy px", *COEFFICIENTS[calibration.left.lens])
    out.print(table(f"{len(found.names)} views", columns, cells))
    noted([f"left out, they disagree: {', '.join(found.left_out)}"] if found.left_out else [])
    camera = rectified_camera(calibration)
    out.print(
        f"{to}: corners {calibration.rms_px:.3f} px rms, rectified rows {rows_px:.3f} px rms "
        f"({'good' if rows_px <= _ROWS_PX else 'BAD'}, at most {_ROWS_PX:g}), "
        f"boards tilted by {found.tilt_deg:.0f}°; rectified: focal length {camera.left.K[0, 0]:.2f} px, "
        f"baseline {1e3 * camera.right.X_CE[0, 3]:.2f} mm",
        highlight=False,
        soft_wrap=True,
    )


def _write(to: Path, calibration: StereoCalibration) -> None:
    try:
        write_calibration(to, calibration)
    except OSError as error:
        raise ConfigurationError("configuration.unwritable", f"{to}: {error.strerror}") from error


def run_convert(files: list[Path], size: tuple[int, int] | None, length_mm: float, to: Path) -> None:
    """Write ``files``' calibration in our own form. Raises ConfigurationError."""
    found = read_calibrations(files, size, 1e-3 * length_mm)
    if size is not None and size != (found.width_px, found.height_px):
        why = f"for pictures of {found.width_px}x{found.height_px}, --size says {size[0]}x{size[1]}"
        raise ConfigurationError("configuration.wrong_size", f"{files[0]}: {why}: calibrate at that size")
    rectified_camera(found)  # a lens that folds over is refused
    _write(to, found)
    out.print(f"{to}: {found.source}, {found.width_px}x{found.height_px} px an eye", highlight=False)
