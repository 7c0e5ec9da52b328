"""The edge of a round dark spot in one eye, and the circle that most of it lies on, laid on a plane."""

import math
from typing import NamedTuple

import cv2
import numpy as np

from foundation.compiled import kernel
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.marker_edges import grey_between
from vision_pc.core.se3 import Array
from vision_pc.core.targets.plane_patch import PlanePatch
from vision_pc.core.targets.target import TargetRefused, frame_on
from vision_pc.core.types import CameraModel, Image

RAYS = 96
_STEP = 0.2  # px between samples of a profile
_WITHIN = 0.035  # of the radius: how far an edge point of the circle may be off it
_WITHIN_PX = 0.35  # and in any case
_LEAST_SHARE = 0.5  # of the rays must show the circle's edge
_WIDEST_GAP = math.radians(150.0)
_CONTRAST = 18.0  # grey levels from inside to outside, and in shade
_CONTRAST_SHARE = 0.3  # of the grey around, but more than noise makes:
_LEAST_CONTRAST = 9.0
FLOOR_PX = 0.04  # [M] what light in the hole and places where the rim breaks out do to its middle
GRAIN_PX = 7.5  # [M] along the rim over which the texture that shifts an edge is alike (docs/targets.md)
_TIGHT = 2.5  # of the usual distance from the circle: what is farther out of it is no part of the edge
_SHIFTS = (0.21, 0.27, 0.33, 0.39)  # of the way round, between the three points of a circle that is tried


class DarkSpot(NamedTuple):
    """A dark round spot in a picture: its middle (2,) px and its radius, px."""

    middle: Array
    radius: float


class Circle(NamedTuple):
    """A circle in the plane's axes: middle (2,), radius, the middle's covariance (2, 2)."""

    middle: Array
    radius: float
    covariance: Array


def axes_of(plane: PlanePatch) -> tuple[Array, Array]:
    """A point of the plane, and its axes as columns (3, 3)."""
    X = frame_on(plane.meet(plane.ray), plane.n)
    return X[:3, 3], X[:3, :3]


def edge(image: Image, spot: DarkSpot) -> Array:
    """Edge points (n, 2) px about a spot, dark inside and bright outside: on each ray the steepest rise."""
    reach = 1.9 * spot.radius + 4.0
    u, v = spot.middle
    left, top = max(int(u - reach) - 2, 0), max(int(v - reach) - 2, 0)
    part = image[top : int(v + reach) + 4, left : int(u + reach) + 4]
    if min(part.shape) < 8:
        return np.zeros((0, 2))
    smooth = cv2.GaussianBlur(part.astype(np.float64), (5, 5), 0.7)
    contrast = min(_CONTRAST, max(_LEAST_CONTRAST, _CONTRAST_SHARE * float(np.median(part))))
    points = _edge_points(np.asarray(smooth), u - left, v - top, spot.radius, contrast)
    return np.asarray(points[np.isfinite(points[:, 0])] + [left, top])


@kernel(nogil=True)
def _edge_points(image: Array, u: float, v: float, radius: float, contrast: float) -> Array:
    """Edge points (rays, 2), NaN where a ray shows none.

    Of each ray the first place outwards from 0.4 radii at which the grey has risen half of the way to the
    brightest that follows within reach, refined by the centroid of its rise.
    """
    points = np.full((RAYS, 2), math.nan)
    height, width = image.shape
    first, last = 0.45 * radius, 1.6 * radius + 2.0
    count = int((last - first) / _STEP) + 1
    profile = np.empty(count)
    for k in range(RAYS):
        angle = 2.0 * math.pi * k / RAYS
        c, s = math.cos(angle), math.sin(angle)
        inside = True
        for i in range(count):
            x, y = u + (first + i * _STEP) * c, v + (first + i * _STEP) * s
            if not (x >= 0.0 and y >= 0.0 and x < width - 1.0 and y < height - 1.0):
                inside = False
                break
            profile[i] = grey_between(image, x, y)
        if not inside:
            continue
        at = _rise(profile, count, contrast)
        if math.isnan(at):
            continue
        r = first + at * _STEP
        points[k, 0], points[k, 1] = u + r * c, v + r * s
    return points


@kernel(nogil=True)
def _rise(profile: Array, count: int, contrast: float) -> float:
    """Where the profile crosses half of its steepest rise from dark to bright, in samples; NaN where that is
    below ``contrast``.
    """
    span = int(2.4 / _STEP)  # px over which an edge rises
    best, at = 0.0, -1
    for i in range(count - span):
        rise = profile[i + span] - profile[i]
        if rise > best:
            best, at = rise, i
    if best < contrast:
        return math.nan
    low, high = profile[at], profile[at + span]
    half = 0.5 * (low + high)
    for i in range(at, at + span):
        if profile[i] <= half < profile[i + 1]:
            return float(i + (half - profile[i]) / (profile[i + 1] - profile[i]))
    return math.nan


def circle(eye: CameraModel, edges: Array, plane: PlanePatch) -> Circle:
    """The circle that most edge points (n, 2) px of ``eye`` lie on, in the plane's axes."""
    if len(edges) < _LEAST_SHARE * RAYS:
        raise TargetRefused(
            "target.not_round", f"target: {len(edges)} of {RAYS} rays show a dark hole's edge"
        )
    rays = intrinsics.normalised(eye, edges)
    directions = np.column_stack([rays, np.ones(len(rays))]) @ eye.X_CE[:3, :3].T
    n, foot = plane.n, eye.X_CE[:3, 3]
    along = (1.0 - n @ foot) / (directions @ n)
    origin, axes = axes_of(plane)
    points = (foot + along[:, None] * directions - origin) @ axes[:, :2]
    px_m = float(np.median(along)) / float(eye.K[0, 0])
    return _fit_circle(points, px_m)


def _fit_circle(points: Array, px_m: float) -> Circle:
    middle, radius = _most_agreed(points, px_m)
    within = _within(radius, px_m)
    for turn in range(8):
        off = points - middle
        far = np.linalg.norm(off, axis=1)
        inlier = np.abs(far - radius) < within
        if turn > 3 and inlier.any():  # what is a little beyond the edge is where it begins to break out
            usual = 1.48 * float(np.median(np.abs(far[inlier] - radius)))
            inlier &= np.abs(far - radius) < max(_TIGHT * usual, 0.1 * px_m)
        if inlier.sum() < 8:
            break
        J = np.column_stack([off[inlier] / far[inlier][:, None], np.ones(inlier.sum())])
        step = np.linalg.lstsq(J, far[inlier] - radius, rcond=None)[0]
        middle, radius = middle + step[:2], radius + float(step[2])
        within = _within(radius, px_m)
    off = points - middle
    far = np.linalg.norm(off, axis=1)
    inlier = np.abs(far - radius) < within
    share = float(inlier.sum()) / RAYS
    angles = np.sort(np.arctan2(off[inlier, 1], off[inlier, 0]))
    gap = float(np.diff(np.append(angles, angles[:1] + 2.0 * math.pi)).max()) if inlier.any() else 7.0
    if share < _LEAST_SHARE or gap > _WIDEST_GAP:
        raise TargetRefused(
            "target.not_round",
            f"target: {100.0 * share:.0f} % of the edge is on a circle, {100.0 * _LEAST_SHARE:.0f} % are "
            f"wanted; widest gap {math.degrees(gap):.0f} degrees",
        )
    J = np.column_stack([off[inlier] / far[inlier][:, None], np.ones(inlier.sum())])
    noise = float(np.std(far[inlier] - radius))
    # Profiles closer together than the grain about the rim say the same: so many of them count.
    apart = min(1.0, 2.0 * math.pi * radius / px_m / RAYS / GRAIN_PX)
    spread = np.linalg.inv(J.T @ J)[:2, :2] * noise**2 / apart
    covariance = spread + (FLOOR_PX * px_m) ** 2 * np.eye(2)
    return Circle(middle, radius, covariance)


def _within(radius: float, px_m: float) -> float:
    return max(_WITHIN * radius, _WITHIN_PX * px_m)


def _most_agreed(points: Array, px_m: float) -> tuple[Array, float]:
    """Middle and radius of the circle through three of the points that most of the others lie on."""
    count = len(points)
    first = np.tile(np.arange(count), len(_SHIFTS))
    shift = np.repeat((np.array(_SHIFTS) * count).astype(int), count)
    a, b, c = points[first], points[(first + shift) % count], points[(first + 2 * shift) % count]
    A = 2.0 * np.stack([b - a, c - a], axis=1)
    y = np.stack([(b * b - a * a).sum(axis=1), (c * c - a * a).sum(axis=1)], axis=1)
    determinant = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    good = np.abs(determinant) > 1e-12
    if not good.any():
        return points.mean(axis=0), 0.0
    A, y, a = A[good], y[good], a[good]
    middles = np.linalg.solve(A, y[..., None])[..., 0]
    radii = np.linalg.norm(a - middles, axis=1)
    far = np.linalg.norm(points[None] - middles[:, None], axis=2)
    limits = np.maximum(_WITHIN * radii, _WITHIN_PX * px_m)
    best = int((np.abs(far - radii[:, None]) < limits[:, None]).sum(axis=1).argmax())
    return middles[best], float(radii[best])
