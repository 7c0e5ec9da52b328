"""A raw stereo camera from pairs of one board: both lenses and the right eye's place.

Each eye by Zhang's method, then everything at once by cv2.stereoCalibrate, which minimises the reprojection
errors of both eyes.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.config.camera_files.parts import Pinhole, document
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import COEFFICIENTS, StereoCalibration
from vision_pc.core.perception.zhang_intrinsics import BoardView, coverage
from vision_pc.core.se3 import Array

LEAST_VIEWS = 8
_ALIKE_PX = 12.0  # rms by which two views' corners must differ at least
_LEAST_COMMON = 6
_LEAST_TILT_DEG = 15.0  # between the two boards that differ most
_LEAST_COVERED = 0.35  # of the cells of each eye's picture
_LARGEST_RMS_PX = 1.0
_OUTLYING = 3.0  # times the median view's error
_ROWS, _COLUMNS = 3, 4
_PLACES = ("upper left", "upper middle", "upper middle", "upper right", "left", "middle", "middle", "right",
           "lower left", "lower middle", "lower middle", "lower right")  # fmt: skip
_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


class PairView(NamedTuple):
    """The corners that both eyes see: ``points_m`` (k, 3) on the board, ``left`` and ``right`` (k, 2) px;
    ``second`` as of a BoardView.
    """

    name: str
    points_m: Array
    left: Array
    right: Array
    second: str = ""


class StereoFit(NamedTuple):
    """The camera, and how views agree with it: ``view_rms_px`` (n,) of both eyes. ``left_out`` names those
    that disagreed and were not used; ``tilt_deg`` between the two boards that differ most.
    """

    calibration: StereoCalibration
    names: tuple[str, ...]
    view_rms_px: Array
    left_out: tuple[str, ...]
    tilt_deg: float


def paired(left: BoardView, right: BoardView) -> PairView:
    """The corners that both views have. Raises MeasurementFailed when they are fewer than 6."""
    ours, theirs = _common(left.points_m, right.points_m)
    if len(ours) < _LEAST_COMMON:
        raise MeasurementFailed(
            "measurement.camera.no_board",
            f"view {left.name}: {len(ours)} corners seen by both eyes, {_LEAST_COMMON} are wanted",
        )
    second = left.second or right.second
    return PairView(left.name, left.points_m[ours], left.pixels[ours], right.pixels[theirs], second)


def _common(points: Array, others: Array) -> tuple[list[int], list[int]]:
    """Where the points (n, 3) are that both have: in the first, and in the second."""
    place = {tuple(point): k for k, point in enumerate(others.round(9))}
    ours = [k for k, point in enumerate(points.round(9)) if tuple(point) in place]
    return ours, [place[tuple(point)] for point in points[ours].round(9)]


def _differ(one: PairView, other: PairView) -> bool:
    ours, theirs = _common(one.points_m, other.points_m)
    apart = one.left[ours] - other.left[theirs]
    return len(ours) < _LEAST_COMMON or float(np.sqrt((apart**2).sum(axis=1).mean())) > _ALIKE_PX


def covered(views: Sequence[PairView], size: tuple[int, int]) -> list[NDArray[np.int64]]:
    """How many corners fell into each of 3 x 4 cells of the left and the right picture."""
    eyes = [view.left for view in views], [view.right for view in views]
    return [coverage(np.concatenate(pixels), size, (_ROWS, _COLUMNS)) for pixels in eyes]


def empty_places(counts: NDArray[np.int64]) -> list[str]:
    """Where in the picture no corner was, in words."""
    return list(dict.fromkeys(_PLACES[k] for k in np.flatnonzero(counts.ravel() == 0)))


def fit(views: Sequence[PairView], size: tuple[int, int], lens: LensModel, source: str) -> StereoFit:
    """The camera that explains ``views`` of pictures of ``size`` (width, height) best.

    Raises RequestRefused (``refused.camera``: too_few_views, views_alike, no_tilt, poor_coverage, lens) and
    MeasurementFailed (``measurement.camera.poor_fit``) where no camera can be believed.
    """
    if lens is LensModel.FISHEYE:
        why = "lens fisheye: such files are read, but boards are fitted with brown-conrady or rational"
        raise RequestRefused("refused.camera.lens", why)
    chosen = _worth_fitting(views, size)
    found = _stereo(chosen, size, lens, source)
    bad = found.view_rms_px > _OUTLYING * float(np.median(found.view_rms_px))
    if bad.any() and len(chosen) - bad.sum() >= LEAST_VIEWS:
        left_out = tuple(view.name for view, out in zip(chosen, bad, strict=True) if out)
        chosen = [view for view, out in zip(chosen, bad, strict=True) if not out]
        found = _stereo(chosen, size, lens, source)._replace(left_out=left_out)
    rms_px = found.calibration.rms_px or 0.0
    if rms_px > _LARGEST_RMS_PX:
        worst = chosen[int(np.argmax(found.view_rms_px))].name
        raise MeasurementFailed(
            "measurement.camera.poor_fit",
            f"{source}: corners are {rms_px:.2f} px rms off the best camera, at most "
            f"{_LARGEST_RMS_PX:g} is believed (worst view {worst}); likely a board that "
            "is not flat, or eyes not exposed together",
        )
    if found.tilt_deg < _LEAST_TILT_DEG:
        raise RequestRefused(
            "refused.camera.no_tilt",
            f"{source}: the boards differ by {found.tilt_deg:.0f} degrees at most, {_LEAST_TILT_DEG:g} are "
            "wanted: tilt the board, or the focal length stays open",
        )
    return found


def _worth_fitting(views: Sequence[PairView], size: tuple[int, int]) -> list[PairView]:
    if len(views) < LEAST_VIEWS:
        raise RequestRefused(
            "refused.camera.too_few_views",
            f"{len(views)} pairs show the board in both eyes, at least {LEAST_VIEWS} are needed, better 20",
        )
    chosen: list[PairView] = []
    for view in views:
        if all(_differ(view, other) for other in chosen):
            chosen.append(view)
    if len(chosen) < LEAST_VIEWS:
        alike = [view.name for view in views if all(view is not one for one in chosen)]
        raise RequestRefused(
            "refused.camera.views_alike",
            f"only {len(chosen)} of {len(views)} views differ by more than {_ALIKE_PX:g} px, at least "
            f"{LEAST_VIEWS} are needed; alike are {', '.join(alike[:6])}{' …' if len(alike) > 6 else ''}: "
            "move the board between pictures",
        )
    for name, counts in zip(("left", "right"), covered(chosen, size), strict=True):
        share = float((counts > 0).mean())
        if share < _LEAST_COVERED:
            raise RequestRefused(
                "refused.camera.poor_coverage",
                f"the board was in {share:.0%} of the {name} picture, {_LEAST_COVERED:.0%} is needed; "
                f"hold it also to the {', '.join(empty_places(counts))}",
            )
    return chosen


def _stereo(views: Sequence[PairView], size: tuple[int, int], lens: LensModel, source: str) -> StereoFit:
    flags = cv2.CALIB_RATIONAL_MODEL if lens is LensModel.RATIONAL else 0
    count = len(COEFFICIENTS[lens])
    points, left, right = (
        [getattr(view, name).astype(np.float32) for view in views] for name in ("points_m", "left", "right")
    )
    try:
        (_, K1, D1, *_), (_, K2, D2, *_) = (
            cv2.calibrateCamera(points, eye, size, np.eye(3), np.zeros(count), flags=flags, criteria=_UNTIL)
            for eye in (left, right)
        )
        rms, K1, D1, K2, D2, R, T, _, _, turns, _, per_view = cv2.stereoCalibrateExtended(
            points, left, right, K1, D1, K2, D2, size, np.eye(3), np.zeros(3),
            flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS, criteria=_UNTIL,
        )  # fmt: skip
    except cv2.error as error:
        why = " ".join(str(error).split())
        raise MeasurementFailed(
            "measurement.camera.poor_fit", f"the views determine no camera: {why}"
        ) from error
    eyes = [Pinhole(_doubles(K), lens, tuple(_doubles(D).ravel()[:count].tolist()), size)
            for K, D in ((K1, D1), (K2, D2))]  # fmt: skip
    content = document(source, (eyes[0], eyes[1]), _doubles(R), _doubles(T).ravel()) | {"rms_px": float(rms)}
    normals = np.stack([cv2.Rodrigues(_doubles(turn))[0][:, 2] for turn in turns])
    tilt_deg = math.degrees(math.acos(float(np.clip(normals @ normals.T, -1.0, 1.0).min())))
    view_rms = np.sqrt((_doubles(per_view).reshape(len(views), 2) ** 2).mean(axis=1))
    names = tuple(view.name for view in views)
    return StereoFit(StereoCalibration.model_validate(content), names, view_rms, (), tilt_deg)


def _doubles(values: Any) -> Array:
    return np.asarray(values, dtype=np.float64)
