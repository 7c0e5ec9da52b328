"""What a stereo camera's calibration leaves: from the markers along the legs, and from odometry's rows.

A look alone cannot tell an offset of the disparity from a baseline or a print that is off: at one distance
they do the same. Along the legs the object comes nearer and wanders across the picture, and they part: an
offset is the same at all distances, a baseline's error grows with the disparity, a lens's with the distance
from the middle. What lenses and a turned eye do to rows shows in every point that odometry follows. All is
found at once: Gauss-Newton on the corners in both eyes and on the rows, with a prior for every unknown; the
bodies' poses, one for each picture, are eliminated (Schur complement).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vision_pc.config.vision import MarkerSettings
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.intrinsics import corrected, prior_stds
from vision_pc.core.perception.markers import corner_points
from vision_pc.core.perception.object_of_interest import marker_in_object
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraErrors, FrameObservation, PointPairs, WatchSample

_ROUNDS = 6
_HUBER = 3.0
_POSE = 6
_STEPS = np.array([1e-2, 1e-2, 1e-4, 1e-2, 1e-2, 1e-5, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4, 1e-4])  # of differences
_CAMERA = len(_STEPS)
_POINT_STEP = 1e-6  # m
_LEAST_PICTURES = 12
_LEAST_M = 0.1  # that the object must wander in camera axes
_PICTURES = 60  # [D] along the legs, at most
_EXPOSED_S = 1e-3  # [S] a ZED2 reads 64 rows in it: a moving picture's corners are off by what they move
_ROW_STD_PX, _ROW_POINTS = 0.1, 1000.0  # [E] of a followed point's row, at best; what all together are worth
_PLATE_STD_M = 3e-4  # [E] a sheet of plastic bent by half a millimetre, turned by half a degree

_PRINT = 16  # unknowns of a print: size, place (3), and how far each corner is off besides (4 × 3)
_INPLANE = 0.3  # of a plate's bend moves corners within its plane


_Picture = tuple[FrameObservation, PointPairs | None, float]
"""What is used of a sample, and how far corners may be off in it (px): rows of a moving picture are read one
after another."""


class _Corners(NamedTuple):
    """All corners seen, a row each: ``points`` (n, 3) in their body, ``centres`` (n, 3) of their prints,
    ``left`` and ``right`` (n, 2) px (right NaN where not seen), ``body`` (n,) which pose they hang on,
    ``marker`` (n,) which print, ``corner`` (n,) which of its four, ``std_px`` (n,).
    """

    points: Array
    centres: Array
    left: Array
    right: Array
    body: NDArray[np.int64]
    marker: NDArray[np.int64]
    corner: NDArray[np.int64]
    std_px: Array


def fitted_errors(
    samples: Sequence[WatchSample], camera: CameraCalibration, settings: MarkerSettings
) -> CameraErrors | None:
    """What the samples of a watch of markers and odometry say of ``camera`` as configured.

    None where that is not asked for, or the object was seen too seldom or in too small a space.
    """
    chosen = _spread_out(samples, camera, settings) if settings.calibration.enabled else []
    if len(chosen) < _LEAST_PICTURES:
        return None
    corners, poses = _corners(chosen, settings)
    rows = _rows(chosen)
    shared = np.zeros(_CAMERA + _PRINT * len(settings.sizes))
    stds = np.concatenate([prior_stds(settings), _print_stds(settings)])
    for _ in range(_ROUNDS):
        H, g = np.diag(stds**-2.0), -shared / stds**2
        corner_H, corner_g, eliminated = _corner_equations(corners, poses, shared, camera)
        row_H, row_g = _row_equations(rows, shared[:_CAMERA], camera)
        H += corner_H
        g += corner_g
        H[:_CAMERA, :_CAMERA] += row_H
        g[:_CAMERA] += row_g
        step = np.linalg.solve(H, g)
        shared = shared + step
        poses = eliminated.moved(poses, step)
    covariance = np.asarray(np.linalg.inv(H)[:_CAMERA, :_CAMERA], dtype=np.float64)
    return CameraErrors(shared[:_CAMERA], covariance)


def _spread_out(
    samples: Sequence[WatchSample], camera: CameraCalibration, settings: MarkerSettings
) -> list[_Picture]:
    """Pictures that show the object, evenly along the way that it makes in them; none where that is short."""
    seen = [(s.X_CO, s.time_ns, s.observation, s.pairs) for s in samples if s.X_CO is not None]
    places = np.array([X_CO[:3, 3] for X_CO, *_ in seen]).reshape(-1, 3)
    if len(seen) < _LEAST_PICTURES or np.ptp(places, axis=0).max() < _LEAST_M:
        return []
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps))
    between = steps / np.maximum(1e-9 * np.diff([float(time_ns) for _, time_ns, *_ in seen]), 1e-3)
    speed = (
        np.maximum(np.append(between, 0.0), np.insert(between, 0, 0.0)) * camera.left.K[0, 0] / places[:, 2]
    )
    std_px = np.hypot(settings.corner_std_px, _EXPOSED_S * speed)
    chosen = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], _PICTURES)))
    pictures = []
    for k in np.minimum(chosen, len(seen) - 1).tolist():
        _, _, observation, pairs = seen[k]
        if observation is not None:
            pictures.append((observation, pairs, float(std_px[k])))
    return pictures


def _corners(pictures: list[_Picture], settings: MarkerSettings) -> tuple[_Corners, Array]:
    """The corners of all markers, and the poses (k, 4, 4) of the bodies that they hang on."""
    seen_at: list[_Corners] = []
    poses: list[Array] = []
    numbers, at_rest = sorted(settings.sizes), settings.corner_std_px  # the tool rests in the picture
    for seen, _, std_px in pictures:
        for X, ids in ((seen.X_CM, {settings.tool.id}), (seen.X_CO, {m.id for m in settings.object})):
            parts = [marker for marker in seen.markers if marker.marker_id in ids]
            if X is None or not parts:
                continue
            for marker in parts:
                number = marker.marker_id
                hung = np.eye(4) if number == settings.tool.id else marker_in_object(number, settings)
                right = np.full((4, 2), np.nan) if marker.corners_right is None else marker.corners_right
                points, centre = se3.apply(hung, corner_points(marker.size)), np.tile(hung[:3, 3], (4, 1))
                body, print_of = np.full(4, len(poses)), np.full(4, numbers.index(number))
                four, std = np.arange(4), np.full(4, std_px if number != settings.tool.id else at_rest)
                eyes = (marker.corners_left, right)
                seen_at.append(_Corners(points, centre, *eyes, body, print_of, four, std))
            poses.append(X)
    whole: Any = (np.concatenate(column) for column in zip(*seen_at, strict=True))
    return _Corners(*whole), np.array(poses)


def _rows(pictures: list[_Picture]) -> PointPairs:
    """Points without a marker in both eyes, of all pictures."""
    nothing = PointPairs(np.zeros((0, 2)), np.zeros((0, 2)))
    parts = [nothing, *(pairs for _, pairs, _ in pictures if pairs is not None)]
    return PointPairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _print_stds(settings: MarkerSettings) -> Array:
    """Of each print's size and place; the tool's hangs where it hangs, and is nobody's but its own."""
    place, bend = max(settings.placement_std_m, 1e-6), _PLATE_STD_M
    corners = 4 * [_INPLANE * bend, _INPLANE * bend, bend]
    return np.concatenate(
        [
            [settings.print_size_std, *[1e-6 if number == settings.tool.id else place] * 3, *corners]
            for number in sorted(settings.sizes)
        ]
    )


class _Eliminated(NamedTuple):
    """How poses follow: inverse blocks (k, 6, 6), gradients (k, 6), coupling (k, 6, s)."""

    inverses: Array
    g: Array
    coupling: Array

    def moved(self, poses: Array, step: Array) -> Array:
        """``poses`` after ``step`` (s,) of what they share."""
        own = np.einsum("kij,kj->ki", self.inverses, self.g - self.coupling @ step)
        return np.array([se3.retract(X, d) for X, d in zip(poses, own, strict=True)])


def _corner_equations(
    corners: _Corners, poses: Array, shared: Array, camera: CameraCalibration
) -> tuple[Array, Array, _Eliminated]:
    """Normal equations (H, g) of all corners in both eyes over what pictures share, poses eliminated."""
    R = poses[corners.body, :3, :3]
    prints = shared[_CAMERA:].reshape(-1, _PRINT)[corners.marker]
    own, at = corners.points - corners.centres, np.arange(len(corners.points))
    bent = prints[:, 4:].reshape(-1, 4, 3)[at, corners.corner]
    levers = np.einsum("nij,nj->ni", R, corners.points + own * prints[:, :1] + prints[:, 1:4] + bent)
    points = levers + poses[corners.body, :3, 3]
    n, s, count = len(points), len(shared), len(poses)
    moves = np.zeros((n, 3, _POSE + s))  # of the point in C
    moves[:, :, :3] = np.eye(3)
    moves[:, :, 3:6] = -np.array([se3.hat(lever) for lever in levers])
    first = _POSE + _CAMERA + _PRINT * corners.marker
    moves[at, :, first] = np.einsum("nij,nj->ni", R, own)
    for axis in range(3):
        moves[at, :, first + 1 + axis] = R[:, :, axis]
        moves[at, :, first + 4 + 3 * corners.corner + axis] = R[:, :, axis]
    H, g = np.zeros((count, _POSE + s, _POSE + s)), np.zeros((count, _POSE + s))
    for eye, measured in enumerate((corners.left, corners.right)):
        residual, J = _linearised(points, measured, eye, shared[:_CAMERA], camera)
        whole = np.einsum("nri,nij->nrj", J[:, :, :3], moves)
        whole[:, :, _POSE : _POSE + _CAMERA] += J[:, :, 3:]
        _gather(H, g, whole, residual, corners)
    inverses = np.asarray(np.linalg.inv(H[:, :_POSE, :_POSE]), dtype=np.float64)
    coupling = H[:, :_POSE, _POSE:]
    carried = np.einsum("kia,kij->kaj", coupling, inverses)
    shared_g = (g[:, _POSE:] - np.einsum("kaj,kj->ka", carried, g[:, :_POSE])).sum(axis=0)
    shared_H = (H[:, _POSE:, _POSE:] - carried @ coupling).sum(axis=0)
    return shared_H, shared_g, _Eliminated(inverses, g[:, :_POSE], coupling)


def _gather(H: Array, g: Array, J: Array, residual: Array, corners: _Corners) -> None:
    """Add rows ``J`` (n, 2, u) with their ``residual`` (n, 2), NaN where not seen, to each body's."""
    seen = np.isfinite(residual).all(axis=1)
    std, body = corners.std_px[seen], corners.body[seen]
    error = residual[seen] / std[:, None]
    weight = np.sqrt(1.0 / np.maximum(1.0, np.linalg.norm(error, axis=1) / _HUBER))
    scaled, error = J[seen] * (weight / std)[:, None, None], error * weight[:, None]
    for k in np.unique(body):
        rows = scaled[body == k].reshape(-1, g.shape[1])
        H[k] += rows.T @ rows
        g[k] += rows.T @ error[body == k].ravel()


def _linearised(
    points: Array, measured: Array, eye: int, errors: Array, camera: CameraCalibration
) -> tuple[Array, Array]:
    """Measured minus expected px (n, 2), and how the expected moves (n, 2, 3 + camera)."""

    def seen(at: Array, values: Array) -> Array:
        believed = corrected(camera, values)
        return intrinsics.project((believed.left, believed.right)[eye], at)

    here = seen(points, errors)
    columns = [(seen(points + _POINT_STEP * axis, errors) - here) / _POINT_STEP for axis in np.eye(3)]
    for k, step in enumerate(_STEPS):
        columns.append((seen(points, errors + step * np.eye(_CAMERA)[k]) - here) / step)
    return measured - here, np.stack(columns, axis=2)


def _row_equations(rows: PointPairs, errors: Array, camera: CameraCalibration) -> tuple[Array, Array]:
    """Normal equations of the rows over the camera's errors: the column tells a point's depth, its row is a
    measurement.
    """
    if len(rows.left) == 0:
        return np.zeros((_CAMERA, _CAMERA)), np.zeros(_CAMERA)
    here = _row_errors(rows, errors, camera)
    columns = [
        (_row_errors(rows, errors + step * np.eye(_CAMERA)[k], camera) - here) / step
        for k, step in enumerate(_STEPS)
    ]
    J = np.column_stack(columns)
    std = max(1.4826 * float(np.median(np.abs(here - np.median(here)))), _ROW_STD_PX)
    weight = 1.0 / np.maximum(1.0, np.abs(here) / (_HUBER * std)) * min(1.0, _ROW_POINTS / len(here))
    scaled = J * (weight / std**2)[:, None]
    return scaled.T @ J, -scaled.T @ here


def _row_errors(rows: PointPairs, errors: Array, camera: CameraCalibration) -> Array:
    """By how many px (m,) the right eye sees points above or below where the left one says that they are."""
    believed = corrected(camera, errors)
    left = intrinsics.normalised(believed.left, rows.left)
    right = intrinsics.normalised(believed.right, rows.right)
    X_RC = se3.inverse(believed.right.X_CE)
    ray = np.column_stack([left, np.ones(len(left))]) @ X_RC[:3, :3].T
    # In the right eye's axes the point is at z ray + p: its column gives z.
    p = X_RC[:3, 3]
    z = (p[0] - right[:, 0] * p[2]) / (right[:, 0] * ray[:, 2] - ray[:, 0])
    point = z[:, None] * ray + p
    return np.asarray((right[:, 1] - point[:, 1] / point[:, 2]) * believed.right.K[1, 1])
