"""`longreach camera calibrate` and `convert`: the one file that everything else reads."""

from pathlib import Path

import numpy as np

from protocol.errors import ConfigurationError, MeasurementFailed, RequestRefused
from testbed.camera.checking import PLAIN, question
from testbed.camera.pairs import AskedBoard, Taken, found_board, take
from testbed.reporting.console import bars, out, table, write_json
from vision_pc.config.camera import CameraSettings
from vision_pc.config.camera_files.reading import read_calibrations, write_calibration
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception.board_finder import second_finders
from vision_pc.core.perception.rectification import geometry, rectified_camera
from vision_pc.core.perception.stereo_fit import PairView, StereoFit

_ROWS_PX = 0.5  # [D] rms of the corners' rows after rectification, a quarter of what odometry takes


def run_calibrate(
    source: str,
    settings: CameraSettings,
    board: AskedBoard,
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
    views, missed = _boards(source, taken, board, (height, width))
    if missed:
        out.print(
            f"no board in both eyes: {', '.join(missed)}", style="yellow", highlight=False, soft_wrap=True
        )
    for line in second_finders(views):
        out.print(line, style="yellow", highlight=False, soft_wrap=True)
    question([pair.left for pair in taken.pairs], board, len(views))
    if views:
        _guide(views, (width, height))
    found = stereo_fit.fit(views, (width, height), lens, f"{Path(source).name}, longreach camera calibrate")
    rows_px = rectified_rows(found.calibration, views)
    try:
        write_calibration(to, found.calibration)
    except OSError as error:
        raise ConfigurationError("configuration.unwritable", f"{to}: {error.strerror}") from error
    _print(found, rows_px, to)
    write_json(json_file, {"fit": found._asdict() | {"calibration": found.calibration.model_dump()},
                           "rows_rms_px": rows_px, "missed": missed})  # fmt: skip
    return rows_px <= _ROWS_PX


def _boards(
    source: str, taken: Taken, board: AskedBoard, shape: tuple[int, int]
) -> tuple[list[PairView], list[str]]:
    """The boards that both eyes see, and the names of pairs without one."""
    height, width = shape
    views: list[PairView] = []
    missed: list[str] = []
    with bars() as shown, shown.step("looking for the board") as bar:
        for k, (name, pair) in enumerate(zip(taken.names, taken.pairs, strict=True)):
            if pair.left.shape != (height, width) or pair.right.shape != (height, width):
                raise RequestRefused(
                    "refused.camera.sizes",
                    f"{source}: {name} differs in size from {taken.names[0]}, {width}x{height}",
                )
            try:
                views.append(found_board(pair, board, name))
            except MeasurementFailed:
                missed.append(name)
            bar.update((k + 1) / len(taken.pairs), f"{len(views)} boards in both eyes")
    return views, missed


def _guide(views: list[PairView], size: tuple[int, int]) -> None:
    """Say where the board was, and where to hold it next."""
    for name, counts in zip(("left", "right"), stereo_fit.covered(views, size), strict=True):
        empty = stereo_fit.empty_places(counts)
        told = f"still empty: {', '.join(empty)}" if empty else "every part of the picture is covered"
        out.print(f"{name} eye: board in {(counts > 0).mean():.0%} of the picture; {told}", highlight=False)


def rectified_rows(calibration: StereoCalibration, views: list[PairView]) -> float:
    """How far the rectified rows of the same corners are apart, rms px."""
    known = geometry(calibration)
    apart = []
    for view in views:
        rows = []
        for pixels, lens, R in (
            (view.left, known.left, known.R_left),
            (view.right, known.right, known.R_right),
        ):
            rays = np.column_stack([lens.undistorted(pixels), np.ones(len(pixels))]) @ R.T
            rows.append(known.K[1, 1] * rays[:, 1] / rays[:, 2])
        apart.append(rows[1] - rows[0])
    return float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))


def _print(found: StereoFit, rows_px: float, to: Path) -> None:
    calibration = found.calibration
    assert calibration.covariance is not None
    std = np.sqrt(np.diag(np.array(calibration.covariance)))
    turn = np.radians(calibration.right_rotation_vector_deg)
    values = []
    for eye in (calibration.left, calibration.right):
        values += [eye.fx_px, eye.fy_px, eye.cx_px, eye.cy_px, *eye.distortion]
    values += [*turn.tolist(), *calibration.right_position_m]
    cells = [[name, f"{value:.6g}", f"{error:.2g}"]
             for name, value, error in zip(calibration.parameters, values, std, strict=True)]  # fmt: skip
    out.print(table(f"{len(found.names)} views", ("parameter", "value", "standard deviation"), cells))
    if found.left_out:
        out.print(f"left out, they disagree: {', '.join(found.left_out)}", style="yellow", highlight=False)
    camera = rectified_camera(calibration)
    out.print(
        f"{to}: corners {calibration.rms_px:.3f} px rms, rectified rows {rows_px:.3f} px rms "
        f"({'good' if rows_px <= _ROWS_PX else 'BAD'}, at most {_ROWS_PX:g}), "
        f"boards tilted by {found.tilt_deg:.0f}°; rectified: focal length {camera.left.K[0, 0]:.2f} px, "
        f"baseline {1e3 * camera.right.X_CE[0, 3]:.2f} mm",
        highlight=False,
        soft_wrap=True,
    )


def run_convert(files: list[Path], size: tuple[int, int] | None, length_mm: float, to: Path) -> None:
    """Write ``files``' calibration in our own form. Raises ConfigurationError."""
    found = read_calibrations(files, size, 1e-3 * length_mm)
    rectified_camera(found)  # a lens that folds over is refused
    try:
        write_calibration(to, found)
    except OSError as error:
        raise ConfigurationError("configuration.unwritable", f"{to}: {error.strerror}") from error
    out.print(f"{to}: {found.source}, {found.width_px}x{found.height_px} px an eye", highlight=False)
