"""A round opening whose rim stands before the surface around it: the mouth of a tube.

What is around it does not tell where the rim is. So circle, plane and distance are found together, from the
edge in both eyes. How the rim is turned it hardly tells itself: an opening of 45 mm at 1 m has two turns that
make the same oval. A tube stands straight out of what carries it, as exactly as it was mounted: the surface
around tells the turn.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets import plane_patch, row_matching
from vision_pc.core.targets.circle_hole import Hole, compared_px, outline_of
from vision_pc.core.targets.plane_patch import PlanePatch, normal_of
from vision_pc.core.targets.round_edge import FLOOR_PX, RAYS, DarkSpot, axes_of, circle, edge
from vision_pc.core.targets.target import TargetRefused, frame_on
from vision_pc.core.types import CameraCalibration, CameraModel, StereoPair

_LEAST_SHARE = 0.7  # of the rays of each eye: the rim is all that tells
_GRAIN_PX = 3.0  # [M] along a rim of one grey over which its edge is shifted alike
_OWN_PX = 0.008  # [M] 1 σ of what light does to one eye's edge and not to the other's
_MOST_PX = 0.35  # rms of the edge about the circle that both eyes agree on
_FIRST = 0.5  # beyond a thin rim the wall may rise more, over the shaded side
_ROUNDS, _STEPS = 3, 12
_STEEPEST = math.radians(55.0)
_MOUNTED = math.radians(
    0.4
)  # [M] 1 σ between a rim and what is told of the surface around; tubes stand straight
_FACING = math.radians(20.0)  # [E] and where nothing around is seen, between the rim and the line of sight
_PLACES, _ENOUGH = 8, 3  # places around that are tried, and how many of them tell the surface
_HALF = 22  # px of their patches
_ALIKE = math.radians(3.0)


class _Seen(NamedTuple):
    """Edge points of one eye as rays (n, 3) in C from its ``foot`` (3,), and which share of it."""

    rays: Array
    foot: Array
    share: float


class _Turn(NamedTuple):
    """What is known of the rim's normal before it is seen: (3,), and its standard deviation, rad."""

    normal: Array
    std: float


class _Fit(NamedTuple):
    """A circle: its frame X (4, 4) and radius, covariance (6, 6) of the frame, how far its edge is off it."""

    X: Array
    radius: float
    covariance: Array
    rms_px: float


def measure(
    pair: StereoPair,
    camera: CameraCalibration,
    spot: DarkSpot,
    depths_m: tuple[float, float],
    diameters_m: tuple[float, float],
) -> Hole:
    """The mouth at ``spot`` of the left picture, of a diameter between ``diameters_m``.

    Raises TargetRefused as ``circle_hole.measure``.
    """
    focal = float(camera.left.K[0, 0])
    nearest = max(depths_m[0], diameters_m[0] * focal / (2.6 * spot.radius))
    farthest = min(depths_m[1], diameters_m[1] * focal / (1.5 * spot.radius))
    if not nearest < farthest:
        raise TargetRefused("target.wrong_size", "target: no tube of such a diameter looks like that here")
    _refuse_ragged(edge(pair.left, spot, _FIRST))  # before what takes long
    found = row_matching.match(pair, camera, spot.middle, (nearest, farthest), compared_px(spot))
    ray = np.append(intrinsics.normalised(camera.left, spot.middle[None])[0], 1.0)
    around, std = _around(pair, camera, spot, depths_m), _MOUNTED
    if around is None:
        around, std = ray / float(np.linalg.norm(ray)), _FACING
    plane = _plane(around * (found.inverse_depth / float(around @ ray)), ray)
    eyes, fit = _settled(pair, camera, spot, plane, std)
    _refuse(eyes, fit, diameters_m)
    mouth = _plane(fit.X[:3, 2] / float(fit.X[:3, 2] @ fit.X[:3, 3]), fit.X[:3, 3] / fit.X[2, 3])
    mouth = mouth._replace(
        quality=min(eye.share for eye in eyes),
        offset_rate=1.0 / float(focal * np.linalg.norm(camera.right.X_CE[:3, 3])),
    )
    return Hole(fit.X, fit.covariance, 2.0 * fit.radius, mouth, outline_of(camera.left, fit.X, fit.radius))


def _refuse_ragged(points: Array) -> None:
    """Raises TargetRefused (``target.not_round``) where edge points (n, 2) px are no oval's."""
    off = math.inf
    if len(points) >= _LEAST_SHARE * RAYS:
        middle, sides, turn = cv2.fitEllipseDirect(points.astype(np.float32))
        c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        on = (points - middle) @ np.array([[c, -s], [s, c]]) / (0.5 * np.maximum(sides, 1e-3))
        off = 0.25 * sum(sides) * float(np.median(np.abs(np.linalg.norm(on, axis=1) - 1.0)))
    if not off < _MOST_PX:
        raise TargetRefused("target.not_round", f"target: its edge is off an oval, limit {_MOST_PX:g} px")


def _settled(
    pair: StereoPair, camera: CameraCalibration, spot: DarkSpot, plane: PlanePatch, std: float
) -> tuple[tuple[_Seen, _Seen], _Fit]:
    """The edges of both eyes and the circle through them, begun at ``plane`` and turned about as it."""
    focal, turn = float(camera.left.K[0, 0]), _Turn(plane.n / np.linalg.norm(plane.n), std)
    for _ in range(_ROUNDS):
        eyes = _edges(pair, camera, spot, plane)
        fit = _fitted(eyes, plane, turn, focal)
        plane = _plane(fit.X[:3, 2] / float(fit.X[:3, 2] @ fit.X[:3, 3]), plane.ray)
    return eyes, fit


def _around(
    pair: StereoPair, camera: CameraCalibration, spot: DarkSpot, depths_m: tuple[float, float]
) -> Array | None:
    """The normal (3,) of the surface about a tube, None where too little of it is seen."""
    normals, reach = list[Array](), 2.5 * spot.radius + _HALF + 12.0
    for k in range(_PLACES):
        angle = 2.0 * math.pi * ((3 * k) % _PLACES) / _PLACES
        pixel = np.rint(spot.middle + reach * np.array([math.cos(angle), math.sin(angle)]))
        try:
            found = row_matching.match(pair, camera, pixel, depths_m)
            n = plane_patch.align(pair, camera, pixel, found.inverse_depth, _HALF).n
        except TargetRefused:
            continue
        normals.append(n / np.linalg.norm(n))
    agreeing = [[other for other in normals if float(one @ other) > math.cos(_ALIKE)] for one in normals]
    most = max(agreeing, key=len, default=[])
    return np.asarray(np.mean(most, axis=0)) if len(most) >= _ENOUGH else None


def _plane(n: Array, ray: Array) -> PlanePatch:
    """The plane n·P = 1 about ``ray``; nothing is told of how well it is known."""
    theta = np.array([n @ ray, n[0], n[1]])
    assert np.allclose(normal_of(theta, ray), n)
    return PlanePatch(theta, np.zeros((3, 3)), ray, 0.0, 0.0)


def _edges(
    pair: StereoPair, camera: CameraCalibration, spot: DarkSpot, plane: PlanePatch
) -> tuple[_Seen, _Seen]:
    """The edge in both eyes: what of it lies on a circle of ``plane``."""
    origin, axes = axes_of(plane)
    seen, eyes = list[_Seen](), ((camera.left, pair.left), (camera.right, pair.right))
    at = spot
    for eye, image in eyes:
        on = circle(eye, edge(image, at, _FIRST), plane)
        points = origin + on.on_circle @ axes[:, :2].T
        foot = eye.X_CE[:3, 3]
        seen.append(_Seen((points - foot) / (points - foot)[:, 2:], foot, on.share))
        if eye is camera.left:
            middle = origin + axes[:, :2] @ on.middle
            at = DarkSpot(_pixel(camera.right, middle), spot.radius)
    return seen[0], seen[1]


def _pixel(eye: CameraModel, p: Array) -> Array:
    return np.asarray(intrinsics.project(eye, p[None])[0])


def _fitted(eyes: tuple[_Seen, _Seen], plane: PlanePatch, turn: _Turn, focal: float) -> _Fit:
    """Gauss-Newton over the middle (3), two turns of the plane and the radius, from a circle of ``plane``."""
    X = frame_on(axes_of(plane)[0], plane.n)
    radius = float(np.median(np.linalg.norm(_on(eyes[0], X), axis=1)))
    # Profiles closer together than what shifts an edge alike say the same.
    apart = min(1.0, 2.0 * math.pi * radius * focal / float(X[2, 3]) / RAYS / _GRAIN_PX)
    noise = FLOOR_PX**2
    for _ in range(_STEPS):
        r, J = _linear(eyes, X, radius, focal)
        noise = max(float(r @ r) / max(len(r) - 6, 1), FLOOR_PX**2)
        H, g = J.T @ J * (apart / noise), J.T @ r * (apart / noise)
        off = X[:3, :2].T @ np.cross(-turn.normal * np.sign(turn.normal @ X[:3, 2]), X[:3, 2])
        H[3:5, 3:5] += np.eye(2) / turn.std**2
        g[3:5] -= off / turn.std**2
        step = np.asarray(-np.linalg.solve(H, g), dtype=np.float64)
        X, radius = _moved(X, step), radius + float(step[5])
        if np.abs(step[:3]).max() < 1e-7 and np.abs(step[3:5]).max() < 1e-6:
            break
    whole = np.linalg.inv(H)
    gained = whole @ J.T * (apart / noise)
    for shift in _systematic(eyes, X):
        moved = gained @ shift
        whole += np.outer(moved, moved)
    to = np.zeros((6, 6))
    to[:3, :3], to[3:, 3:5] = np.eye(3), X[:3, :2]
    return _Fit(X, radius, to @ whole @ to.T, math.sqrt(noise))


def _moved(X: Array, step: Array) -> Array:
    turn = X[:3, :2] @ step[3:5]
    return frame_on(X[:3, 3] + step[:3], X[:3, 2] + np.cross(turn, X[:3, 2]))


def _on(eye: _Seen, X: Array) -> Array:
    """Where the edge's rays meet the plane of ``X``, in its x and y (n, 2)."""
    n, p = X[:3, 2], X[:3, 3]
    along = (n @ (p - eye.foot)) / (eye.rays @ n)
    return np.asarray((eye.foot + along[:, None] * eye.rays - p) @ X[:3, :2])


def _residuals(eyes: tuple[_Seen, _Seen], X: Array, radius: float, focal: float) -> Array:
    """How far (px) the edge lies outside of the circle, (n,)."""
    px = focal / float(X[2, 3])
    return np.concatenate([px * (np.linalg.norm(_on(eye, X), axis=1) - radius) for eye in eyes])


def _linear(eyes: tuple[_Seen, _Seen], X: Array, radius: float, focal: float) -> tuple[Array, Array]:
    r, J = _residuals(eyes, X, radius, focal), list[Array]()
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5
        J.append((_residuals(eyes, _moved(X, step), radius + float(step[5]), focal) - r) / 1e-5)
    return r, np.column_stack(J)


def _systematic(eyes: tuple[_Seen, _Seen], X: Array) -> list[Array]:
    """What light does to the whole edge, as residuals (n,) for 1 σ: it shifts and stretches it, much the same
    in both eyes.
    """
    angles = [np.arctan2(*_on(eye, X).T[::-1]) for eye in eyes]
    shifts = list[Array]()
    for order in (1.0, 2.0):
        for wave in (np.cos, np.sin):
            left, right = (wave(order * angle) for angle in angles)
            shifts.append(FLOOR_PX * np.append(left, right))
            shifts.append(_OWN_PX * np.append(left, -right))
    return shifts


def _refuse(eyes: tuple[_Seen, _Seen], fit: _Fit, diameters_m: tuple[float, float]) -> None:
    share = min(eye.share for eye in eyes)
    if share < _LEAST_SHARE or fit.rms_px > _MOST_PX:
        raise TargetRefused(
            "target.not_round",
            f"target: {100.0 * share:.0f} % of a rim's edge is on a circle, {100.0 * _LEAST_SHARE:.0f} % are "
            f"wanted; {fit.rms_px:.2f} px off it, limit {_MOST_PX:g} px",
        )
    p, n = fit.X[:3, 3], fit.X[:3, 2]
    steep = math.acos(min(abs(float(n @ p)) / float(np.linalg.norm(p)), 1.0))
    if steep > _STEEPEST:
        raise TargetRefused(
            "target.not_planar",
            f"target: the rim is {math.degrees(steep):.0f} degrees off the line of sight, "
            f"limit {math.degrees(_STEEPEST):.0f}",
        )
    if not diameters_m[0] <= 2.0 * fit.radius <= diameters_m[1]:
        low, high = (1e3 * size for size in diameters_m)
        raise TargetRefused(
            "target.wrong_size",
            f"target: a mouth of {2e3 * fit.radius:.1f} mm, {low:.0f} to {high:.0f} mm are wanted",
        )
