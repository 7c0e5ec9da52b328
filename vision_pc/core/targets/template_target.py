"""A patch of a surface that was taught once, found again by its looks: where it is, and how it is turned.

What is taught is the patch as seen from straight above, in metres. In a later picture it is drawn as the eye
would see it and searched for; a second place that looks as good is refused. Then it is laid on the plane that
both eyes measure there, and shifted and turned in that plane until the left eye's greys agree.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets.plane_patch import PlanePatch, residual_spread
from vision_pc.core.targets.target import TargetRefused, Taught, frame_on
from vision_pc.core.types import CameraModel, Image

LEAST_HALF, MOST_HALF = 15, 60  # px on either side of what is taught
_LEAST = 0.6  # correlation below which it was not found
_MARGIN = 0.1  # by which the best place must beat every other
_APART = 0.5  # of its half width between places that are different ones
_SCALES = (0.72, 0.85, 1.0, 1.18, 1.39)  # of its size in the picture, where nobody knows how far it is
_ROLLS_DEG = (-20.0, -10.0, 0.0, 10.0, 20.0)
_COARSE = 2  # a picture half as fine is searched first
_SMOOTHED = 1.1
_STEPS = 20
_FLOOR_PX = 0.012  # [M] what interpolation and the surface's relief leave
_AGREE = 0.7  # correlation that is left once it lies where it belongs


class Place(NamedTuple):
    """Where a taught patch lies: its middle (2,) px of the left eye, its turn from the camera's x, rad."""

    pixel: Array
    turn: float


class Laid(NamedTuple):
    """A patch laid on a plane: X (4, 4), covariance (3, 3) of its shift in the plane (m) and turn (rad)."""

    X: Array
    covariance: Array
    correlation: float


def teach(image: Image, eye: CameraModel, X: Array, half_px: int) -> Taught:
    """The patch about ``X`` (4, 4) on its plane, ``half_px`` on either side as the eye sees it.

    Raises TargetRefused: ``target.outside_picture``, and ``target.ambiguous`` where another place of the
    picture looks the same.
    """
    half = min(max(half_px, LEAST_HALF), MOST_HALF)
    texel = float(X[2, 3] / eye.K[0, 0])
    u, v = _pixels(eye, X, half, texel)
    inside = (u.min() >= 1.0, v.min() >= 1.0, u.max() < image.shape[1] - 2, v.max() < image.shape[0] - 2)
    if not all(inside):
        raise TargetRefused(
            "target.outside_picture", f"target: {half} px about it are not all in the picture"
        )
    taught = Taught(_sampled(_smooth(image), u, v), texel)
    pixel = intrinsics.project(eye, X[None, :3, 3])[0]
    found = _search(image, _drawn(eye, taught, X, half), None, half)
    others = [
        place
        for place, score in found
        if score > 1.0 - 2.0 * _MARGIN and np.linalg.norm(place - pixel) > _APART * half
    ]
    if others:
        at = others[0]
        raise TargetRefused(
            "target.ambiguous", f"target: the place at ({at[0]:.0f}, {at[1]:.0f}) px looks the same"
        )
    return taught


def find(image: Image, eye: CameraModel, taught: Taught, expected: Array, reach_px: int | None) -> Place:
    """Where ``taught`` is in a left picture: within ``reach_px`` of ``expected`` (4, 4), None: anywhere.

    Raises TargetRefused: ``target.not_found``, ``target.ambiguous``.
    """
    half = len(taught.grey) // 2
    level = frame_on(expected[:3, 3], expected[:3, 2])
    turn = math.atan2(*(float(expected[:3, 0] @ level[:3, k]) for k in (1, 0)))
    if reach_px is not None:
        pixel = intrinsics.project(eye, expected[None, :3, 3])[0]
        found = _search(image, _drawn(eye, taught, expected, half), (pixel, reach_px), half)
        return Place(_only(found, half), turn)
    small = cv2.resize(image, None, fx=1.0 / _COARSE, fy=1.0 / _COARSE, interpolation=cv2.INTER_AREA)
    tried = list[tuple[float, Array, float]]()
    for scale in _SCALES:
        for roll_deg in _ROLLS_DEG:
            drawn = _drawn(eye, taught, _turned(expected, math.radians(roll_deg)), half, scale / _COARSE)
            for place, score in _search(np.asarray(small), drawn, None, len(drawn) // 2):
                tried.append((score, place * _COARSE + 0.5 * (_COARSE - 1), math.radians(roll_deg)))
    tried.sort(key=lambda each: -each[0])
    best = _only([(place, score) for score, place, _ in tried], half)
    return Place(best, turn + next(roll for _, place, roll in tried if place is best))


def lay(image: Image, eye: CameraModel, taught: Taught, plane: PlanePatch, place: Place) -> Laid:
    """``taught`` on ``plane``, shifted and turned in it from ``place`` until the greys agree.

    Raises TargetRefused (``target.not_found``) where they do not.
    """
    smooth, half = _smooth(image), len(taught.grey) // 2
    ray = np.append(intrinsics.normalised(eye, place.pixel[None])[0], 1.0)
    X = _turned(frame_on(plane.meet(ray), plane.n), place.turn)
    T, count = taught.grey, len(taught.grey)
    J = np.zeros((count, count, 6))
    J[..., 3], J[..., 4] = T, 1.0
    gain, bias, r, G = 1.0, 0.0, T, np.eye(5)
    for _ in range(_STEPS):
        r, steps = _compared(smooth, eye, taught, X, half, (gain, bias))
        J[..., :3] = steps
        A = J[..., :5].reshape(-1, 5)
        G = np.asarray(np.linalg.inv(A.T @ A + 1e-12 * np.eye(5)), dtype=np.float64)
        step = G @ (A.T @ r.ravel())
        X = _shifted(X, step[:3])
        gain, bias = gain + float(step[3]), bias + float(step[4])
        if np.abs(step[:2]).max() < 0.002 * taught.texel_m:
            break
        if np.linalg.norm(X[:3, 3] - plane.meet(ray)) > 0.5 * half * taught.texel_m:
            raise TargetRefused("target.not_found", "target: what was taught does not lie there")
    agreed = float(np.corrcoef((gain * T + bias).ravel(), (gain * T + bias + r).ravel())[0, 1])
    if not agreed > _AGREE:
        raise TargetRefused(
            "target.not_found", f"target: what was taught agrees by {agreed:.2f}, {_AGREE} is wanted"
        )
    whole = G @ residual_spread(J, r, np.ones_like(r))[:5, :5] @ G
    floor = (_FLOOR_PX * taught.texel_m) ** 2 * np.diag([1.0, 1.0, 2.0 / (half * taught.texel_m) ** 2])
    return Laid(X, whole[:3, :3] + floor, agreed)


def outline(eye: CameraModel, taught: Taught, X: Array) -> Array:
    """The rim of a taught patch at ``X`` as the left eye sees it, (4, 2) px."""
    u, v = _pixels(eye, X, len(taught.grey) // 2, taught.texel_m)
    corners = [(0, 0), (0, -1), (-1, -1), (-1, 0)]
    return np.array([[u[at], v[at]] for at in corners])


def _compared(
    smooth: Array, eye: CameraModel, taught: Taught, X: Array, half: int, light: tuple[float, float]
) -> tuple[Array, Array]:
    """Greys seen less those taught (n, n), and minus their change by shift and turn (n, n, 3)."""
    u, v = _pixels(eye, X, half, taught.texel_m)
    grey = _sampled(smooth, u, v)
    along = 0.5 * (_sampled(smooth, u + 1.0, v) - _sampled(smooth, u - 1.0, v))
    down = 0.5 * (_sampled(smooth, u, v + 1.0) - _sampled(smooth, u, v - 1.0))
    change = np.empty((*grey.shape, 3))
    for k, size in enumerate((1e-5, 1e-5, 1e-4)):
        u_k, v_k = _pixels(eye, _shifted(X, size * np.eye(3)[k]), half, taught.texel_m)
        change[..., k] = -(along * (u_k - u) + down * (v_k - v)) / size
    return grey - (light[0] * taught.grey + light[1]), change


def _shifted(X: Array, step: Array) -> Array:
    """``X`` shifted along its x and y (m), then turned about its z (rad)."""
    moved = _turned(X, float(step[2]))
    moved[:3, 3] = X[:3, 3] + X[:3, :2] @ step[:2]
    return moved


def _turned(X: Array, angle: float) -> Array:
    return np.asarray(X @ se3.transform(se3.exp_so3(np.array([0.0, 0.0, angle])), np.zeros(3)))


def _pixels(eye: CameraModel, X: Array, half: int, texel_m: float) -> tuple[Array, Array]:
    """Where the eye sees the grid of (2 half + 1)² texels about ``X``: u and v, each (n, n)."""
    reach = np.arange(-half, half + 1) * texel_m
    x, y = np.meshgrid(reach, -reach)
    p = se3.apply(X, np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    pixels = intrinsics.distorted(eye, p[:, :2] / p[:, 2:])
    return pixels[:, 0].reshape(x.shape), pixels[:, 1].reshape(x.shape)


def _smooth(image: Image) -> Array:
    return np.asarray(cv2.GaussianBlur(image.astype(np.float32), (7, 7), _SMOOTHED))


def _sampled(smooth: Array, u: Array, v: Array) -> Array:
    """Greys at places (n, n) px."""
    maps = u.astype(np.float32), v.astype(np.float32)
    return np.asarray(
        cv2.remap(smooth, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), dtype=np.float64
    )


def _drawn(eye: CameraModel, taught: Taught, X: Array, half: int, scale: float = 1.0) -> Image:
    """The taught patch as the eye sees it at ``X``, (m, m), ``scale`` times as fine."""
    u, v = intrinsics.project(eye, X[None, :3, 3])[0]
    side = max(int(half * scale * float(taught.texel_m * eye.K[0, 0] / X[2, 3]) * 0.8), 6)
    offsets = np.arange(-side, side + 1) / (scale if scale > 0.0 else 1.0)
    columns, rows = np.meshgrid(u + offsets, v + offsets)
    rays = intrinsics.normalised(eye, np.column_stack([columns.ravel(), rows.ravel()]))
    directions = np.column_stack([rays, np.ones(len(rays))])
    n = X[:3, 2]
    on = ((n @ X[:3, 3]) / (directions @ n))[:, None] * directions - X[:3, 3]
    x, y = (on @ X[:3, 0] / taught.texel_m + half, -(on @ X[:3, 1]) / taught.texel_m + half)
    shape = columns.shape
    grey = taught.grey.astype(np.float32)
    picture = cv2.remap(
        grey, x.reshape(shape).astype(np.float32), y.reshape(shape).astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _search(
    image: Image, drawn: Image, about: tuple[Array, int] | None, half: int
) -> list[tuple[Array, float]]:
    """Places (2,) px that look like ``drawn``, best first, and their correlations."""
    left = top = 0
    side = len(drawn) // 2
    part = image
    if about is not None:
        (u, v), reach = np.rint(about[0]).astype(int), about[1] + side
        left, top = max(u - reach, 0), max(v - reach, 0)
        part = image[top : max(v + reach + 1, 0), left : max(u + reach + 1, 0)]
    if min(part.shape) < len(drawn) + 2:
        return []
    scores = cv2.matchTemplate(cv2.GaussianBlur(part, (5, 5), 0.8), drawn, cv2.TM_CCOEFF_NORMED)
    size = 2 * max(int(_APART * half), 2) + 1
    peaks = (scores >= cv2.dilate(scores, np.ones((size, size), np.uint8))) & (scores > 0.4)
    rows, columns = np.nonzero(peaks)
    order = np.argsort(-scores[rows, columns], kind="stable")[:20]
    return [
        (np.array([columns[k] + left + side, rows[k] + top + side], dtype=np.float64),
         float(scores[rows[k], columns[k]]))
        for k in order
    ]  # fmt: skip


def _only(found: list[tuple[Array, float]], half: int) -> Array:
    if not found or found[0][1] < _LEAST:
        score = found[0][1] if found else 0.0
        raise TargetRefused("target.not_found", f"target: correlation {score:.2f}, {_LEAST} is wanted")
    best, score = found[0]
    for place, other in found[1:]:
        if other > score - _MARGIN and np.linalg.norm(place - best) > _APART * half:
            raise TargetRefused(
                "target.ambiguous", f"target: the place at ({place[0]:.0f}, {place[1]:.0f}) px looks as alike"
            )
    return best
