"""What a measurement of a target gives, whatever was looked at, and how it is refused."""

from typing import Literal, NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3
from vision_pc.core.se3 import Array

Kind = Literal["plane", "hole"]
_ROLL_STD = 1e-3  # rad; the turn about the normal is no measurement: it is chosen by the camera's x axis


class TargetObservation(NamedTuple):
    """A target in one pair.

    ``X_CO`` (4, 4): origin at the target, z the outward normal of the surface, x along the camera's x as far
    as the surface allows: the axes of an object of interest. ``covariance`` and ``bias`` (6, 6) as in
    ``FrameObservation``: the whole, and what consecutive frames share. ``quality`` 0…1 is how much of the
    texture both eyes agree on. ``outline`` (n, 2): px of the left eye. ``diameter_m`` of a hole, else None.
    """

    kind: Kind
    X_CO: Array
    covariance: Array
    bias: Array
    quality: float
    outline: Array
    diameter_m: float | None = None


class Candidate(NamedTuple):
    """One of several places that look alike: the right eye's pixel, and the point (3,) in C that it means."""

    right_px: tuple[float, float]
    p_C: Array


class TargetRefused(MeasurementFailed):
    """A target that cannot be measured; ``cause`` begins with ``target.``. ``candidates``: what it may be."""

    def __init__(self, cause: str, message: str, candidates: tuple[Candidate, ...] = ()) -> None:
        super().__init__(cause, message)
        self.candidates = candidates


def frame_on(p: Array, normal: Array) -> Array:
    """X (4, 4) at ``p``: z is the surface's ``normal``, turned towards the camera, x along the camera's."""
    z = normal / np.linalg.norm(normal)
    if z @ p > 0.0:
        z = -z
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return se3.transform(np.column_stack([x, np.cross(z, x), z]), p)


def with_roll(covariance: Array, X: Array) -> Array:
    """``covariance`` (6, 6), never singular: the turn about the normal, and a hundredth of a millimetre."""
    z, floor = X[:3, 2], np.diag([1e-10, 1e-10, 1e-10, 1e-10, 1e-10, 1e-10])
    floor[3:, 3:] += _ROLL_STD**2 * np.outer(z, z)
    return np.asarray(covariance + floor)
