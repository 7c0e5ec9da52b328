"""A round hole: its edge in both eyes, laid on the plane of the surface around it, where it is a circle.

Edge points are met with the plane first and the circle is fitted there, in metres: so the slant of the view
and the perspective of the circle's centre are taken care of, and no conic has two answers. Only the outer
edge counts, dark inside and bright outside: what is deeper in the hole moves with the eye.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets import plane_patch, row_matching
from vision_pc.core.targets.place_on_plane import moved_by_plane
from vision_pc.core.targets.plane_patch import PlanePatch
from vision_pc.core.targets.round_edge import Circle, DarkSpot, axes_of, circle, edge
from vision_pc.core.targets.target import TargetRefused, frame_on
from vision_pc.core.targets.wider_patch import wider
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoPair

_SURROUNDINGS_PX = 101
_LEVELS = (0.62, 0.5, 0.38, 0.26)  # of the surroundings' brightness below which a pixel is dark
_LEAST_RADIUS, _MOST_RADIUS = 3.0, 60.0  # px
_LEAST_FILL = 0.55  # of the rectangle about it that a disc fills: 0.79
_MOST_STRETCH = 2.2


def dark_spots(image: Image, region: tuple[int, int, int, int] | None = None) -> list[DarkSpot]:
    """Dark round spots, each once in its most compact form; ``region`` (left, top, right, bottom) px."""
    left, top, right, bottom = region or (0, 0, image.shape[1], image.shape[0])
    part = np.ascontiguousarray(image[top:bottom, left:right])
    if min(part.shape) < 8:
        return []
    around = cv2.blur(part, (_SURROUNDINGS_PX, _SURROUNDINGS_PX), borderType=cv2.BORDER_REFLECT)
    smooth = cv2.GaussianBlur(part, (3, 3), 0.8)
    found: list[tuple[float, DarkSpot]] = []
    for level in _LEVELS:
        dark = (smooth.astype(np.float32) < level * around).astype(np.uint8)
        count, _, stats, centroids = cv2.connectedComponentsWithStats(dark, connectivity=4)
        for k in range(1, count):
            compact, spot = _spot(stats[k], centroids[k] + np.array([left, top]))
            if compact > 0.0:
                found.append((compact, spot))
    kept: list[DarkSpot] = []
    for _, spot in sorted(found, key=lambda each: -each[0]):
        if all(np.linalg.norm(spot.middle - other.middle) > 0.7 * other.radius for other in kept):
            kept.append(spot)
    return kept


def _spot(stats: Array, middle: Array) -> tuple[float, DarkSpot]:
    """How compact a component is, 0 for what is no disc, and the spot that it makes."""
    width, height, area = float(stats[2]), float(stats[3]), float(stats[4])
    radius = (area / np.pi) ** 0.5
    fill, stretch = area / (width * height), max(width, height) / min(width, height)
    disc = _LEAST_RADIUS <= radius <= _MOST_RADIUS and fill >= _LEAST_FILL and stretch <= _MOST_STRETCH
    return fill / stretch if disc else 0.0, DarkSpot(np.asarray(middle, dtype=np.float64), float(radius))


_MASKED = 1.45  # radii about the middle that the surface is not taken from: broken rims, chips
_RING = 2.6  # radii that the surface is taken from, and at least:
_LEAST_RING_PX = 24
_MOST_RING_PX = 60
_WIDER_RING_PX = 45
_MATCHED = 1.25  # radii that the eyes are compared in: the dark inside alone looks alike everywhere
_PART = 1.15  # of its radius by which a hole is wider than a spot that is a part of it
_EYES_APART = 0.08  # of the diameter by which the two eyes' middles may differ
_ROUNDS = 3


class Hole(NamedTuple):
    """A measured hole: X_CO with its covariance (6, 6), its diameter and the surface around it."""

    X_CO: Array
    covariance: Array
    diameter_m: float
    plane: PlanePatch
    outline: Array


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
    compared = max(row_matching.HALF, int(_MATCHED * spot.radius))  # px: the rim with it
    inverse_depth = row_matching.match(pair, camera, spot.middle, (nearest, farthest), compared)
    try:
        hole = _measure_hole(pair, camera, spot, inverse_depth)
    except TargetRefused as refused:
        # What is seen inside may be as bright as the rim, and the dark be a part of the hole.
        wide = DarkSpot(spot.middle, 0.25 * sum(diameters_m) * focal * inverse_depth)
        if refused.cause != "target.not_round" or wide.radius < _PART * spot.radius:
            raise
        hole = _measure_hole(pair, camera, wide, inverse_depth)
    if not diameters_m[0] <= hole.diameter_m <= diameters_m[1]:
        low, high = (1e3 * size for size in diameters_m)
        raise TargetRefused(
            "target.wrong_size",
            f"target: a hole of {1e3 * hole.diameter_m:.1f} mm, {low:.0f} to {high:.0f} mm are wanted",
        )
    return hole


def _measure_hole(pair: StereoPair, camera: CameraCalibration, spot: DarkSpot, inverse_depth: float) -> Hole:
    """The hole at ``spot``, of whatever diameter. Raises TargetRefused as ``measure``."""
    plane = _surface(pair, camera, spot, inverse_depth)
    edges = edge(pair.left, spot)
    for _ in range(_ROUNDS):
        left = circle(camera.left, edges, plane)
        again = DarkSpot(_pixel(camera.left, left, plane), spot.radius)
        if np.abs(again.middle - spot.middle).max() < 0.3:
            break
        spot = again
        edges = edge(pair.left, spot)
    in_right = DarkSpot(_pixel(camera.right, left, plane), spot.radius)
    right = circle(camera.right, edge(pair.right, in_right), plane)
    apart = float(np.linalg.norm(left.middle - right.middle))
    if apart > _EYES_APART * (left.radius + right.radius) + 3.0 * _depth_std(plane):
        raise TargetRefused(
            "target.not_round", f"target: the eyes see the hole's middle {1e3 * apart:.1f} mm apart"
        )
    return _hole(camera, left, right, plane)


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


def _hole(camera: CameraCalibration, left: Circle, right: Circle, plane: PlanePatch) -> Hole:
    origin, axes = axes_of(plane)
    # Along the baseline the right eye's middle moves with the plane's depth, which knows less than the left.
    baseline = axes[:, :2].T @ camera.right.X_CE[:3, 3]
    baseline /= np.linalg.norm(baseline)
    apart = right.middle - left.middle
    middle = left.middle + 0.5 * (apart - baseline * (baseline @ apart))
    X = frame_on(origin + axes[:, :2] @ middle, plane.n)
    covariance = np.zeros((6, 6))
    # What texture does to an edge both eyes see alike: two eyes are no surer than one.
    covariance[:3, :3] = axes[:, :2] @ (0.5 * (left.covariance + right.covariance)) @ axes[:, :2].T
    J = moved_by_plane(plane, X[:3, 3] / X[2, 3])
    covariance += J @ plane.covariance @ J.T
    radius = 0.5 * (left.radius + right.radius)
    return Hole(X, covariance, 2.0 * radius, plane, outline_of(camera.left, X, radius))


def outline_of(eye: CameraModel, X: Array, radius: float) -> Array:
    """The circle about ``X`` (4, 4) as the left eye sees it, (n, 2) px."""
    turns = np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False)
    rim = se3.apply(X, radius * np.column_stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)]))
    return np.asarray(intrinsics.distorted(eye, rim[:, :2] / rim[:, 2:]))


def _depth_std(plane: PlanePatch) -> float:
    return float(np.sqrt(plane.covariance[0, 0])) / float(plane.theta[0]) ** 2


def _pixel(eye: CameraModel, circle: Circle, plane: PlanePatch) -> Array:
    """Where ``eye`` sees the middle of a circle of the plane, (2,) px."""
    origin, axes = axes_of(plane)
    p_C = origin + axes[:, :2] @ circle.middle
    return np.asarray(intrinsics.project(eye, p_C[None])[0])
