"""A patch of a surface that was taught once, found again by its looks: where it is, and how it is turned.

What is taught is the patch as seen from straight above, in metres. In a later picture it is drawn as the eye
would see it and searched for; a second place that looks as good is refused. Then it is laid on the plane that
both eyes measure there, and shifted and turned in that plane until the left eye's greys agree.
"""

from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets.plane_patch import PlanePatch, residual_spread
from vision_pc.core.targets.target import TargetRefused, Taught, frame_on
from vision_pc.core.targets.template_search import (
    APART,
    MARGIN,
    TEXTURE_MARGIN,
    Place,
    drawn_as_seen,
    places_like,
    texture_alike,
    turned,
)
from vision_pc.core.types import CameraModel, Image

LEAST_HALF, MOST_HALF = 15, 60  # px on either side of what is taught
_SMOOTHED = 1.1
_STEPS = 20
_FLOOR_PX = 0.012  # [M] what interpolation and the surface's relief leave
_AGREE = 0.7  # correlation that is left once it lies where it belongs


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
    drawn = drawn_as_seen(eye, taught, X, half)
    alike = texture_alike(image, drawn, pixel) - TEXTURE_MARGIN
    others = [
        place
        for place, score in places_like(image, drawn, None, half)
        if score > 1.0 - 2.0 * MARGIN
        and np.linalg.norm(place - pixel) > APART * half
        and texture_alike(image, drawn, place) > alike
    ]
    if others:
        at = others[0]
        raise TargetRefused(
            "target.ambiguous", f"target: the place at ({at[0]:.0f}, {at[1]:.0f}) px looks the same"
        )
    return taught


def lay(image: Image, eye: CameraModel, taught: Taught, plane: PlanePatch, place: Place) -> Laid:
    """``taught`` on ``plane``, shifted and turned in it from ``place`` until the greys agree.

    Raises TargetRefused (``target.not_found``) where they do not.
    """
    smooth, half = _smooth(image), len(taught.grey) // 2
    ray = np.append(intrinsics.normalised(eye, place.pixel[None])[0], 1.0)
    X = turned(frame_on(plane.meet(ray), plane.n), place.turn)
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
    moved = turned(X, float(step[2]))
    moved[:3, 3] = X[:3, 3] + X[:3, :2] @ step[:2]
    return moved


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
