"""A raw stereo camera from pairs of one board: both lenses, the right eye's place, and how well each is
known.

Each eye by Zhang's method, then everything at once by cv2.stereoCalibrate, which minimises the reprojection
errors of both eyes. The covariance is that of this adjustment, the boards' poses unknown too.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import COEFFICIENTS, FORMAT, StereoCalibration
from vision_pc.core import se3
from vision_pc.core.perception.zhang_intrinsics import BoardView
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
    """The camera, how the views agree with it, and where in the picture no board was.

    ``view_rms_px`` (n,) of both eyes; ``left_out`` names views that disagreed and were not used;
    ``rows_px``: median and 95 % of how far apart the rectified rows of a corner are; ``empty`` says for each
    eye where no corner was.
    """

    calibration: StereoCalibration
    names: tuple[str, ...]
    view_rms_px: Array
    left_out: tuple[str, ...]
    empty: tuple[tuple[str, ...], tuple[str, ...]]
    tilt_deg: float


class _Raw(NamedTuple):
    """What cv2.stereoCalibrate gives: a point p of the left eye is at R p + T in the right one."""

    K: tuple[Array, Array]
    D: tuple[Array, Array]
    R: Array
    T: Array
    turns: Array
    shifts: Array
    rms_px: float
    view_rms_px: Array


def paired(left: BoardView, right: BoardView) -> PairView:
    """The corners that both views have. Raises MeasurementFailed when they are fewer than 6."""
    index = {tuple(point): k for k, point in enumerate(right.points_m.round(9))}
    common = [
        (k, index[tuple(point)]) for k, point in enumerate(left.points_m.round(9)) if tuple(point) in index
    ]
    if len(common) < _LEAST_COMMON:
        raise MeasurementFailed(
            "measurement.camera.no_board",
            f"view {left.name}: {len(common)} corners seen by both eyes, {_LEAST_COMMON} are wanted",
        )
    ours, theirs = (list(k) for k in zip(*common, strict=True))
    second = left.second or right.second
    return PairView(left.name, left.points_m[ours], left.pixels[ours], right.pixels[theirs], second)


def distinct(views: Sequence[PairView]) -> list[PairView]:
    """``views`` without those that show the board where an earlier one does."""
    chosen: list[PairView] = []
    for view in views:
        if all(_differ(view, other) for other in chosen):
            chosen.append(view)
    return chosen


def _differ(one: PairView, other: PairView) -> bool:
    places = {tuple(point): k for k, point in enumerate(other.points_m.round(9))}
    common = [
        (k, places[tuple(point)]) for k, point in enumerate(one.points_m.round(9)) if tuple(point) in places
    ]
    if len(common) < _LEAST_COMMON:
        return True
    ours, theirs = (list(k) for k in zip(*common, strict=True))
    apart = one.left[ours] - other.left[theirs]
    return float(np.sqrt((apart**2).sum(axis=1).mean())) > _ALIKE_PX


def covered(views: Sequence[PairView], size: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How many corners fell into each of 3 x 4 cells of the left and the right picture."""
    counts = []
    for pixels in (
        np.concatenate([view.left for view in views]),
        np.concatenate([view.right for view in views]),
    ):
        found = np.histogram2d(
            pixels[:, 1], pixels[:, 0], bins=(_ROWS, _COLUMNS), range=((0, size[1]), (0, size[0]))
        )[0]
        counts.append(found.astype(np.int64))
    return counts[0], counts[1]


def empty_places(counts: NDArray[np.int64]) -> tuple[str, ...]:
    """Where in the picture no corner was, in words."""
    return tuple(
        dict.fromkeys(name for name, count in zip(_PLACES, counts.ravel(), strict=True) if count == 0)
    )


def fit(views: Sequence[PairView], size: tuple[int, int], lens: LensModel, source: str) -> StereoFit:
    """The camera that explains ``views`` of pictures of ``size`` (width, height) best.

    Raises RequestRefused (``refused.camera``: too_few_views, views_alike, no_tilt, poor_coverage, lens) and
    MeasurementFailed (``measurement.camera.poor_fit``) where no camera can be believed.
    """
    if lens is LensModel.FISHEYE:
        why = "lens fisheye: such files are read, but boards are fitted with brown-conrady or rational"
        raise RequestRefused("refused.camera.lens", why)
    chosen = _worth_fitting(views, size)
    raw = _stereo(chosen, size, lens)
    bad = raw.view_rms_px > _OUTLYING * float(np.median(raw.view_rms_px))
    left_out = tuple(view.name for view, out in zip(chosen, bad, strict=True) if out)
    if left_out and len(chosen) - len(left_out) >= LEAST_VIEWS:
        chosen = [view for view, out in zip(chosen, bad, strict=True) if not out]
        raw = _stereo(chosen, size, lens)
    else:
        left_out = ()
    if raw.rms_px > _LARGEST_RMS_PX:
        worst = chosen[int(np.argmax(raw.view_rms_px))].name
        raise MeasurementFailed(
            "measurement.camera.poor_fit",
            f"{source}: corners are {raw.rms_px:.2f} px rms off the best camera, at most "
            f"{_LARGEST_RMS_PX:g} is believed (worst view {worst}); likely a board that "
            "is not flat, or eyes not exposed together",
        )
    tilt = _tilt_deg(raw.turns)
    if tilt < _LEAST_TILT_DEG:
        raise RequestRefused(
            "refused.camera.no_tilt",
            f"{source}: the boards differ by {tilt:.0f} degrees at most, {_LEAST_TILT_DEG:g} are wanted: "
            "tilt the board, or the focal length stays open",
        )
    counts = covered(chosen, size)
    return StereoFit(
        _calibration(chosen, raw, size, lens, source),
        tuple(view.name for view in chosen),
        raw.view_rms_px,
        left_out,
        (empty_places(counts[0]), empty_places(counts[1])),
        tilt,
    )


def _worth_fitting(views: Sequence[PairView], size: tuple[int, int]) -> list[PairView]:
    if len(views) < LEAST_VIEWS:
        raise RequestRefused(
            "refused.camera.too_few_views",
            f"{len(views)} pairs show the board in both eyes, at least {LEAST_VIEWS} are needed, better 20",
        )
    chosen = distinct(views)
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


def _stereo(views: Sequence[PairView], size: tuple[int, int], lens: LensModel) -> _Raw:
    flags = cv2.CALIB_RATIONAL_MODEL if lens is LensModel.RATIONAL else 0
    count = len(COEFFICIENTS[lens])
    points = [view.points_m.astype(np.float32) for view in views]
    seen = [
        [view.left.astype(np.float32) for view in views],
        [view.right.astype(np.float32) for view in views],
    ]
    try:
        eyes = [
            cv2.calibrateCamera(
                points, pixels, size, np.eye(3), np.zeros(count), flags=flags, criteria=_UNTIL
            )
            for pixels in seen
        ]
        found = cv2.stereoCalibrateExtended(
            points, seen[0], seen[1], eyes[0][1], eyes[0][2], eyes[1][1], eyes[1][2], size,
            np.eye(3), np.zeros(3),
            flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS, criteria=_UNTIL,
        )  # fmt: skip
    except cv2.error as error:
        why = " ".join(str(error).split())
        raise MeasurementFailed(
            "measurement.camera.poor_fit", f"the views determine no camera: {why}"
        ) from error
    rms, K1, D1, K2, D2, R, T, _, _, turns, shifts, per_view = found
    D = [_doubles(one).ravel()[:count] for one in (D1, D2)]
    view_rms = np.sqrt((_doubles(per_view).reshape(len(views), 2) ** 2).mean(axis=1))
    board_turns = _doubles(turns).reshape(len(views), 3)
    board_shifts = _doubles(shifts).reshape(len(views), 3)
    cameras, bends = (_doubles(K1), _doubles(K2)), (D[0], D[1])
    stereo = _doubles(R), _doubles(T).ravel()
    return _Raw(cameras, bends, stereo[0], stereo[1], board_turns, board_shifts, float(rms), view_rms)


def _doubles(values: Any) -> Array:
    return np.asarray(values, dtype=np.float64)


def _tilt_deg(turns: Array) -> float:
    normals = np.stack([se3.exp_so3(turn)[:, 2] for turn in turns])
    return math.degrees(math.acos(float(np.clip(normals @ normals.T, -1.0, 1.0).min())))


def _calibration(
    views: Sequence[PairView], raw: _Raw, size: tuple[int, int], lens: LensModel, source: str
) -> StereoCalibration:
    X_LR = se3.inverse(se3.transform(raw.R, raw.T))
    eyes = [
        {
            "lens": lens,
            "fx_px": K[0, 0],
            "fy_px": K[1, 1],
            "cx_px": K[0, 2],
            "cy_px": K[1, 2],
            "distortion": tuple(D),
        }
        for K, D in zip(raw.K, raw.D, strict=True)
    ]
    covariance = _covariance(views, raw)
    return StereoCalibration.model_validate(
        {
            "format": FORMAT,
            "source": source,
            "width_px": size[0],
            "height_px": size[1],
            "left": eyes[0],
            "right": eyes[1],
            "right_position_m": tuple(X_LR[:3, 3].tolist()),
            "right_rotation_vector_deg": tuple(np.degrees(se3.log_so3(X_LR[:3, :3])).tolist()),
            "rms_px": raw.rms_px,
            "covariance": tuple(tuple(row) for row in covariance.tolist()),
        }
    )


def _covariance(views: Sequence[PairView], raw: _Raw) -> Array:
    """Of all parameters in the order of ``StereoCalibration.parameters``, the boards' poses unknown too."""
    count = 4 + len(raw.D[0])
    size = 2 * count + 6
    turn = _doubles(cv2.Rodrigues(raw.R)[0]).ravel()
    information, squares, seen = np.zeros((size, size)), 0.0, 0
    for view, board_turn, board_shift in zip(views, raw.turns, raw.shifts, strict=True):
        left, by_pose, by_left = _project_with_derivatives(view, board_turn, board_shift, raw.K[0], raw.D[0])
        joined = cv2.composeRT(board_turn, board_shift, turn, raw.T)
        right_turn, right_shift = (_doubles(joined[k]).ravel() for k in (0, 1))
        # derivatives of the right eye's board pose by the left one's, and by the stereo pose
        by = np.block(
            [[joined[2], joined[3], joined[4], joined[5]], [joined[6], joined[7], joined[8], joined[9]]]
        )
        right, by_right_pose, by_right = _project_with_derivatives(
            view, right_turn, right_shift, raw.K[1], raw.D[1]
        )
        poses = np.concatenate([by_pose, by_right_pose @ by[:, :6]])
        rest = np.zeros((len(poses), size))
        rest[: len(left), :count] = by_left
        rest[len(left) :, count : 2 * count] = by_right
        rest[len(left) :, 2 * count :] = by_right_pose @ by[:, 6:]
        rest -= poses @ np.linalg.lstsq(poses, rest, rcond=None)[0]
        information += rest.T @ rest
        errors = np.concatenate([left - view.left.ravel(), right - view.right.ravel()])
        squares, seen = squares + float(errors @ errors), seen + len(errors)
    variance = squares / max(seen - size - 6 * len(views), 1)
    scale = 1.0 / np.sqrt(np.diag(information))
    found = (
        variance
        * np.linalg.pinv(information * np.outer(scale, scale), hermitian=True)
        * np.outer(scale, scale)
    )
    change = np.eye(size)
    change[-6:, -6:] = _to_ours(turn, raw.T)
    result = change @ found @ change.T
    return np.asarray(0.5 * (result + result.T))


def _project_with_derivatives(
    view: PairView, turn: Array, shift: Array, K: Array, D: Array
) -> tuple[Array, Array, Array]:
    """Pixels (2 k,), their derivatives by the board's pose (2 k, 6), and by fx fy cx cy and distortion."""
    pixels, slopes = cv2.projectPoints(view.points_m, turn, shift, K, D)
    by = _doubles(slopes)
    return _doubles(pixels).ravel(), by[:, :6], by[:, 6 : 10 + len(D)]


def _to_ours(turn: Array, shift: Array) -> Array:
    """Derivatives (6, 6) of the right eye's rotation vector and place in C by OpenCV's rotation vector and
    T.
    """

    def ours(values: Array) -> Array:
        X_LR = se3.inverse(se3.transform(se3.exp_so3(values[:3]), values[3:]))
        return np.concatenate([se3.log_so3(X_LR[:3, :3]), X_LR[:3, 3]])

    at, step = np.concatenate([turn, shift]), 1e-6
    return np.stack([(ours(at + d) - ours(at - d)) / (2.0 * step) for d in step * np.eye(6)], axis=1)
