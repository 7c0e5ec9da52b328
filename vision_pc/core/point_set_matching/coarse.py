"""Coarse frame alignment: one right-handed frame laid into each of two traces of the same path.

It keeps the fine match from a mirrored or flipped answer (Mäkinen et al. 2023, section 3.2.2, step 1). What
it needs of the path, an open and bent shape that is not its own mirror image, is measured by ``path_shape``
so that a path can be refused before the arm moves.
"""

from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core.se3 import Array, exp_so3

_SMOOTHING = (
    7  # samples among which the medoid is sought that keeps single glitches out of end points and plane
)
_TWIN_STEP_RAD = np.deg2rad(5.0)


class PathShape(NamedTuple):
    """How well a trace fixes a rotation. All but ``extent_m`` are ratios to its extent (rms radius).

    ``straightness``: second principal spread over the first (0: a line). ``openness``: distance of the ends.
    ``turning``: signed area between path and chord over chord times extent.
    """

    extent_m: float
    straightness: float
    openness: float
    turning: float


def path_shape(points: Array) -> PathShape:
    """The shape numbers of ``points`` (N, 3), metres, in any frame.

    Raises MeasurementFailed for fewer than four points or no extent.
    """
    if len(points) < 4:
        raise MeasurementFailed(
            "measurement.too_few_samples", f"path: {len(points)} points, at least 4 are wanted"
        )
    smooth = _without_glitches(points)
    centred = smooth - smooth.mean(axis=0)
    extent = _extent(centred)
    if extent < 1e-6:
        raise MeasurementFailed("measurement.path_too_short", "path: all points are in one place")
    spreads = np.linalg.svd(centred, compute_uv=False)
    chord = smooth[-1] - smooth[0]
    openness = float(np.linalg.norm(chord)) / extent
    turning = float(np.linalg.norm(_area_vector(smooth))) / (extent * max(float(np.linalg.norm(chord)), 1e-9))
    return PathShape(extent, float(spreads[1] / spreads[0]), openness, turning)


def path_frame(points: Array) -> Array:
    """R (3×3) whose columns are the path's own axes: chord in the plane, across, normal.

    ``points`` (N, 3) in time order. The normal is that of the principal plane, with the sign of the turning
    direction: the area between path and chord counts positive. Raises MeasurementFailed when the path is
    straight (``measurement.path_straight``), closed (``.path_closed``) or turns as much left as right
    (``.path_symmetric``): then the frame would hang on noise.
    """
    shape = path_shape(points)
    if shape.straightness < 0.05:
        raise MeasurementFailed(
            "measurement.path_straight",
            f"path: spread ratio {shape.straightness:.3f}, at least 0.05 is wanted",
        )
    if shape.openness < 0.5:
        raise MeasurementFailed(
            "measurement.path_closed",
            f"path: ends {shape.openness:.2f} extents apart, at least 0.5 is wanted",
        )
    if shape.turning < 0.02:
        raise MeasurementFailed(
            "measurement.path_symmetric",
            f"path: turning measure {shape.turning:.3f}, at least 0.02 is wanted",
        )
    smooth = _without_glitches(points)
    normal = np.linalg.svd(smooth - smooth.mean(axis=0), full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ _area_vector(smooth))
    chord = smooth[-1] - smooth[0]
    first = chord - (chord @ normal) * normal
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(normal, first), normal])


def coarse_alignment(points_camera: Array, points_base: Array) -> Array:
    """R_cfa (3×3), which turns camera axes roughly into base axes; both traces (N, 3), (M, 3) in time order.

    Raises MeasurementFailed as ``path_frame``.
    """
    R: Array = path_frame(points_base) @ path_frame(points_camera).T
    return R


def asymmetry(points: Array) -> float:
    """The rms distance, in extents, from ``points`` (N, 3) as an unordered set to the nearest of its twins.

    A twin is the set turned by 180° about any axis in its plane, or by any angle over 20° within it. At zero,
    a match without time association has more than one answer.
    """
    if len(points) > 80:
        points = points[np.linspace(0, len(points) - 1, 80).astype(int)]
    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    normal = axes[2] if np.linalg.det(axes) > 0 else -axes[2]
    turns = np.arange(np.deg2rad(20.0), np.deg2rad(340.1), _TWIN_STEP_RAD)
    twins = [exp_so3(normal * turn) for turn in turns]
    for angle in np.arange(0.0, np.pi, _TWIN_STEP_RAD):
        axis = np.cos(angle) * axes[0] + np.sin(angle) * axes[1]
        twins.append(2.0 * np.outer(axis, axis) - np.eye(3))
    turned = centred @ np.stack(twins).transpose(0, 2, 1)
    squared = ((turned[:, :, None, :] - centred[None, None, :, :]) ** 2).sum(axis=-1)
    return float(np.sqrt(squared.min(axis=2).mean(axis=1).min())) / _extent(centred)


def _extent(centred: Array) -> float:
    """Rms distance (m) of ``centred`` (N, 3) from the origin."""
    return float(np.sqrt((centred**2).sum(axis=1).mean()))


def _without_glitches(points: Array) -> Array:
    """``points`` (N, 3), each replaced by the medoid of its neighbours, mirrored at the ends.

    The medoid, unlike the median of each coordinate, turns with the points.
    """
    if len(points) < 2 * _SMOOTHING:
        return points
    half = _SMOOTHING // 2
    padded = np.pad(points, ((half, half), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, _SMOOTHING, axis=0).swapaxes(1, 2)
    apart = np.linalg.norm(windows[:, :, None] - windows[:, None], axis=-1).sum(axis=-1)
    smooth: Array = windows[np.arange(len(points)), apart.argmin(axis=1)]
    return smooth


def _area_vector(points: Array) -> Array:
    """The vector area (3,) between the path and its chord, right-handed in the direction of travel."""
    from_start = points - points[0]
    area: Array = 0.5 * np.cross(from_start[:-1], from_start[1:]).sum(axis=0)
    return area
