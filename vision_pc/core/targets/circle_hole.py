"""A round hole: its edge in both eyes, laid on the plane of the surface around it, where it is a circle.

Edge points are met with the plane first and the circle is fitted there, in metres: so the slant of the view
and the perspective of the circle's centre are taken care of, and no conic has two answers. Only the outer
edge counts, dark inside and bright outside: what is deeper in the hole moves with the eye.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from foundation.compiled import kernel
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets import plane_patch, row_matching
from vision_pc.core.targets.plane_patch import PlanePatch
from vision_pc.core.targets.target import TargetRefused, frame_on
from vision_pc.core.targets.wider_patch import wider
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoPair

_RAYS = 96
_STEP = 0.2  # px between samples of a profile
_WITHIN = 0.035  # of the radius: how far an edge point of the circle may be off it
_WITHIN_PX = 0.35  # and in any case
_LEAST_SHARE = 0.5  # of the rays must show the circle's edge
_WIDEST_GAP = math.radians(150.0)
_CONTRAST = 18.0  # grey levels from inside to outside
_MASKED = 1.45  # radii about the middle that the surface is not taken from: broken rims, chips
_RING = 2.6  # radii that the surface is taken from, and at least:
_LEAST_RING_PX = 24
_MOST_RING_PX = 60
_WIDER_RING_PX = 45
_EYES_APART = 0.08  # of the diameter by which the two eyes' middles may differ
_ROUNDS = 3
_FLOOR_PX = 0.04  # [M] what light in the hole and places where the rim breaks out do to its middle
_GRAIN_PX = 7.5  # [M] along the rim over which the texture that shifts an edge is alike (docs/targets.md)
_TIGHT = 2.5  # of the usual distance from the circle: what is farther out of it is no part of the edge
_SHIFTS = (0.21, 0.27, 0.33, 0.39)  # of the way round, between the three points of a circle that is tried


class DarkSpot(NamedTuple):
    """A dark round spot in a picture: its middle (2,) px and its radius, px."""

    middle: Array
    radius: float


class Hole(NamedTuple):
    """A measured hole: X_CO with its covariance (6, 6), its diameter and the surface around it."""

    X_CO: Array
    covariance: Array
    diameter_m: float
    plane: PlanePatch
    outline: Array


class _Circle(NamedTuple):
    """A circle in the plane's axes: middle (2,), radius, the middle's covariance (2, 2), share of rays."""

    middle: Array
    radius: float
    covariance: Array
    share: float
    on_circle: Array


def measure(
    pair: StereoPair,
    camera: CameraCalibration,
    spot: DarkSpot,
    depths_m: tuple[float, float],
    diameters_m: tuple[float, float],
) -> Hole:
    """The hole at ``spot`` of the left picture, of a diameter between ``diameters_m``.

    Holes of a row look alike: of places in the right picture that do, the one that counts makes this spot as
    wide as holes are. Raises TargetRefused: as ``row_matching.match`` and ``plane_patch.align``,
    ``target.not_round`` when either eye shows no circle there, ``target.wrong_size``.
    """
    focal = float(camera.left.K[0, 0])
    widest = tuple(
        size * focal / (2.0 * spot.radius) for size in (0.7 * diameters_m[0], 1.4 * diameters_m[1])
    )
    nearest, farthest = max(depths_m[0], widest[0]), min(depths_m[1], widest[1])
    if not nearest < farthest:
        raise TargetRefused("target.wrong_size", "target: no hole of such a diameter looks like that here")
    found = row_matching.match(pair, camera, spot.middle, (nearest, farthest))
    plane = _surface(pair, camera, spot, found.inverse_depth)
    edges = _edge(pair.left, spot)
    for _ in range(_ROUNDS):
        left = _circle(camera.left, edges, plane)
        again = DarkSpot(_pixel(camera.left, left, plane), spot.radius)
        if np.abs(again.middle - spot.middle).max() < 0.3:
            break
        spot = again
        edges = _edge(pair.left, spot)
    in_right = DarkSpot(_pixel(camera.right, left, plane), spot.radius)
    right = _circle(camera.right, _edge(pair.right, in_right), plane)
    apart = float(np.linalg.norm(left.middle - right.middle))
    if apart > _EYES_APART * (left.radius + right.radius) + 3.0 * _depth_std(plane):
        raise TargetRefused(
            "target.not_round", f"target: the eyes see the hole's middle {1e3 * apart:.1f} mm apart"
        )
    hole = _hole(camera, left, right, plane)
    if not diameters_m[0] <= hole.diameter_m <= diameters_m[1]:
        low, high = (1e3 * size for size in diameters_m)
        raise TargetRefused(
            "target.wrong_size",
            f"target: a hole of {1e3 * hole.diameter_m:.1f} mm, {low:.0f} to {high:.0f} mm are wanted",
        )
    return hole


def _surface(pair: StereoPair, camera: CameraCalibration, spot: DarkSpot, inverse_depth: float) -> PlanePatch:
    half = int(min(max(_RING * spot.radius, spot.radius + _LEAST_RING_PX), _MOST_RING_PX))
    rows, columns = np.mgrid[-half : half + 1, -half : half + 1]
    ring = np.hypot(rows, columns) > _MASKED * spot.radius + 2.0
    middle = np.rint(spot.middle)
    plane = plane_patch.align(pair, camera, middle, inverse_depth, half, ring)
    if half >= _WIDER_RING_PX:
        return plane
    all_around = np.pad(ring, _WIDER_RING_PX - half, constant_values=True)
    return wider(pair, camera, plane, middle, _WIDER_RING_PX, all_around)


def _hole(camera: CameraCalibration, left: _Circle, right: _Circle, plane: PlanePatch) -> Hole:
    origin, axes = _axes(plane)
    # Along the baseline the right eye's middle moves with the plane's depth, which knows less than the left.
    baseline = axes[:, :2].T @ camera.right.X_CE[:3, 3]
    baseline /= np.linalg.norm(baseline)
    apart = right.middle - left.middle
    middle = left.middle + 0.5 * (apart - baseline * (baseline @ apart))
    X = frame_on(origin + axes[:, :2] @ middle, plane.n)
    covariance = np.zeros((6, 6))
    # What texture does to an edge both eyes see alike: two eyes are no surer than one.
    covariance[:3, :3] = axes[:, :2] @ (0.5 * (left.covariance + right.covariance)) @ axes[:, :2].T
    ray = X[:3, 3] / X[2, 3]
    stds = np.sqrt(np.diag(plane.covariance))
    J = np.zeros((6, 3))
    for k in range(3):
        theta = plane.theta + stds[k] * np.eye(3)[k]
        n = plane_patch.normal_of(theta, plane.ray)
        J[:, k] = se3.local(X, frame_on(ray / (n @ ray), n)) / stds[k]
    covariance += J @ plane.covariance @ J.T
    radius = 0.5 * (left.radius + right.radius)
    turns = np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False)
    rim = se3.apply(X, radius * np.column_stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)]))
    outline = intrinsics.distorted(camera.left, rim[:, :2] / rim[:, 2:])
    return Hole(X, covariance, 2.0 * radius, plane, outline)


def _depth_std(plane: PlanePatch) -> float:
    return float(np.sqrt(plane.covariance[0, 0])) / float(plane.theta[0]) ** 2


def _axes(plane: PlanePatch) -> tuple[Array, Array]:
    """A point of the plane, and its axes as columns (3, 3)."""
    X = frame_on(plane.meet(plane.ray), plane.n)
    return X[:3, 3], X[:3, :3]


def _edge(image: Image, spot: DarkSpot) -> Array:
    """Edge points (n, 2) px about a spot, dark inside and bright outside."""
    reach = 1.9 * spot.radius + 4.0
    u, v = spot.middle
    left, top = max(int(u - reach) - 2, 0), max(int(v - reach) - 2, 0)
    part = image[top : int(v + reach) + 4, left : int(u + reach) + 4]
    if min(part.shape) < 8:
        return np.zeros((0, 2))
    smooth = cv2.GaussianBlur(part.astype(np.float64), (5, 5), 0.7)
    points = _edge_points(np.asarray(smooth), u - left, v - top, spot.radius)
    return np.asarray(points[np.isfinite(points[:, 0])] + [left, top])


@kernel(nogil=True)
def _edge_points(image: Array, u: float, v: float, radius: float) -> Array:
    """Edge points (rays, 2), NaN where a ray shows none.

    Of each ray the first place outwards from 0.4 radii at which the grey has risen half of the way to the
    brightest that follows within reach, refined by the centroid of its rise.
    """
    points = np.full((_RAYS, 2), math.nan)
    height, width = image.shape
    first, last = 0.45 * radius, 1.6 * radius + 2.0
    count = int((last - first) / _STEP) + 1
    profile = np.empty(count)
    for k in range(_RAYS):
        angle = 2.0 * math.pi * k / _RAYS
        c, s = math.cos(angle), math.sin(angle)
        inside = True
        for i in range(count):
            x, y = u + (first + i * _STEP) * c, v + (first + i * _STEP) * s
            if not (x >= 0.0 and y >= 0.0 and x < width - 1.0 and y < height - 1.0):
                inside = False
                break
            profile[i] = _bilinear(image, x, y)
        if not inside:
            continue
        at = _rise(profile, count)
        if math.isnan(at):
            continue
        r = first + at * _STEP
        points[k, 0], points[k, 1] = u + r * c, v + r * s
    return points


@kernel(nogil=True, inline="always")
def _bilinear(image: Array, x: float, y: float) -> float:
    column, row = int(x), int(y)
    a, b = x - column, y - row
    upper = image[row, column] * (1.0 - a) + image[row, column + 1] * a
    lower = image[row + 1, column] * (1.0 - a) + image[row + 1, column + 1] * a
    return float(upper * (1.0 - b) + lower * b)


@kernel(nogil=True)
def _rise(profile: Array, count: int) -> float:
    """Where the profile crosses half of its steepest rise from dark to bright, in samples; NaN without."""
    span = int(2.4 / _STEP)  # px over which an edge rises
    best, at = 0.0, -1
    for i in range(count - span):
        rise = profile[i + span] - profile[i]
        if rise > best:
            best, at = rise, i
    if best < _CONTRAST:
        return math.nan
    low, high = profile[at], profile[at + span]
    half = 0.5 * (low + high)
    for i in range(at, at + span):
        if profile[i] <= half < profile[i + 1]:
            return float(i + (half - profile[i]) / (profile[i + 1] - profile[i]))
    return math.nan


def _circle(eye: CameraModel, edges: Array, plane: PlanePatch) -> _Circle:
    """The circle that most edge points (n, 2) px of ``eye`` lie on, in the plane's axes."""
    if len(edges) < _LEAST_SHARE * _RAYS:
        raise TargetRefused(
            "target.not_round", f"target: {len(edges)} of {_RAYS} rays show a dark hole's edge"
        )
    rays = intrinsics.normalised(eye, edges)
    directions = np.column_stack([rays, np.ones(len(rays))]) @ eye.X_CE[:3, :3].T
    n, foot = plane.n, eye.X_CE[:3, 3]
    along = (1.0 - n @ foot) / (directions @ n)
    origin, axes = _axes(plane)
    points = (foot + along[:, None] * directions - origin) @ axes[:, :2]
    px_m = float(np.median(along)) / float(eye.K[0, 0])
    return _fitted(points, px_m)


def _fitted(points: Array, px_m: float) -> _Circle:
    middle, radius = _most_agreed(points, px_m)
    within = _within(radius, px_m)
    for turn in range(8):
        off = points - middle
        far = np.linalg.norm(off, axis=1)
        kept = np.abs(far - radius) < within
        if turn > 3:  # what is a little beyond the edge is where it begins to break out
            usual = 1.48 * float(np.median(np.abs(far[kept] - radius)))
            kept &= np.abs(far - radius) < max(_TIGHT * usual, 0.1 * px_m)
        if kept.sum() < 8:
            break
        J = np.column_stack([off[kept] / far[kept][:, None], np.ones(kept.sum())])
        step = np.linalg.lstsq(J, far[kept] - radius, rcond=None)[0]
        middle, radius = middle + step[:2], radius + float(step[2])
        within = _within(radius, px_m)
    off = points - middle
    far = np.linalg.norm(off, axis=1)
    kept = np.abs(far - radius) < within
    share = float(kept.sum()) / _RAYS
    angles = np.sort(np.arctan2(off[kept, 1], off[kept, 0]))
    gap = float(np.diff(np.append(angles, angles[:1] + 2.0 * math.pi)).max()) if kept.any() else 7.0
    if share < _LEAST_SHARE or gap > _WIDEST_GAP:
        raise TargetRefused(
            "target.not_round",
            f"target: {100.0 * share:.0f} % of the edge is on a circle, {100.0 * _LEAST_SHARE:.0f} % are "
            f"wanted; widest gap {math.degrees(gap):.0f} degrees",
        )
    J = np.column_stack([off[kept] / far[kept][:, None], np.ones(kept.sum())])
    noise = float(np.std(far[kept] - radius))
    # Profiles closer together than the grain about the rim say the same: so many of them count.
    apart = min(1.0, 2.0 * math.pi * radius / px_m / _RAYS / _GRAIN_PX)
    spread = np.linalg.inv(J.T @ J)[:2, :2] * noise**2 / apart
    covariance = spread + (_FLOOR_PX * px_m) ** 2 * np.eye(2)
    return _Circle(middle, radius, covariance, share, points[kept])


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


def _pixel(eye: CameraModel, circle: _Circle, plane: PlanePatch) -> Array:
    """Where ``eye`` sees the middle of a circle of the plane, (2,) px."""
    origin, axes = _axes(plane)
    p_C = origin + axes[:, :2] @ circle.middle
    return np.asarray(intrinsics.project(eye, p_C[None])[0])
