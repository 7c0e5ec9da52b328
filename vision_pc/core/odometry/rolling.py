"""A rolling shutter in recordings: found in the residuals, and taken out of the rays.

Rows are read one after the other, so a moving camera sees the lower rows from a later place. What a point in
row v misses by is its motion in the picture times the share of the interval between two pictures that has
passed since the middle row. That share is one number of the camera: it is learnt from all pictures that move.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel

_SURE = 8.0  # standard deviations, before a shutter is believed to roll
_LEAST_SHARE = 0.05  # 1.7 ms at 30 pictures a second: what looks like less may be depths that are off
_MOST_SHARE = 1.05  # a readout ends before the next begins
_LEAST_POINTS = 20
_ABOUT = 0.02  # what a pass over a recording knows the share to
_HALF = 0.5  # the same where the motion before is unknown too
_UNKNOWN = 0.12  # of the motion during the readout: acceleration, and what the share is found to
_STEADY = 0.5  # of how much the motion changes about a picture: what the mean of before and after misses


class PointViews(NamedTuple):
    """Points (n, 3) in C, both eyes' rays (2, n, 2) to them, measured minus expected px (2, n, 2), which were
    seen (2, n), and how views move with the points' inverse depths (2, n, 2).
    """

    points_C: Array
    rays: Array
    errors_px: Array
    seen: Array
    by_depth: Array

    def alone(self, moves: Array) -> Array:
        """``moves`` (2, n, 2) px in a row, without what other depths of the points would explain: the map's
        depths have given way to the shutter already.
        """
        seen = self.seen[:, :, None] > 0.0
        by_depth = np.where(seen, self.by_depth, 0.0)
        shown = np.where(seen, moves, 0.0)
        size = np.maximum((by_depth**2).sum(axis=(0, 2)), 1e-12)
        share = (by_depth * shown).sum(axis=(0, 2)) / size
        return np.asarray((shown - by_depth * share[None, :, None]).ravel())


class PictureMotion(NamedTuple):
    """The ``twist`` (6,) of the camera between pictures about one of them, in its own axes, and how much of
    it is ``unknown`` (6,), standard deviations.
    """

    twist: Array
    unknown: Array


class TakenOut(NamedTuple):
    """What was taken out of a picture: its ``twist`` (6,) for a ``share`` of the interval."""

    twist: Array
    share: float


class Readout:
    """``share``: the readout's length over the interval between pictures, 0 as long as none shows."""

    def __init__(self, camera: CameraCalibration, learns: bool) -> None:
        self.share = 0.0
        self._height = camera.height
        self._learns = learns
        self._known = False
        self._information = self._sum = 0.0
        self._X_C0C: Array | None = None
        self._motions: Mapping[int, PictureMotion] = {}
        self._told: PictureMotion | None = None
        self._before = self._twist = self._fastest = np.zeros(6)

    @property
    def is_global(self) -> bool:
        """Whether an earlier pass found no rolling: what one motion leaves is then not the shutter's."""
        return self._known and not self.share

    def begin(self, share: float, motions: Mapping[int, PictureMotion]) -> None:
        """Begin with what an earlier pass over the same pictures found: about the ``share``, and by the
        pictures' numbers their ``motions``.
        """
        self.share, self._known = share, True
        self._motions = motions
        twists = [motion.twist for motion in motions.values()]
        self._fastest = max(twists, key=lambda twist: float(np.linalg.norm(twist)), default=np.zeros(6))
        self._information = _ABOUT**-2.0
        self._sum = share * self._information

    def spread(
        self, eyes: tuple[CameraModel, CameraModel], views: "PointViews", rates: Array, weights: Array
    ) -> Array:
        """What taking the shutter out leaves unknown of a pose, covariance (6×6) of [δp; δθ] with which the
        ``views``, of ``weights`` (2, n), go by ``rates`` (2, n, 2, 6): the pose takes upon itself what it can
        of a motion during the readout that is not quite that between pictures.
        """
        since = np.stack([self._since(eye, rays) for eye, rays in zip(eyes, views.rays, strict=True)])
        bends = np.stack([since[:, :, None] * _moves(eyes, views.points_C, axis) for axis in np.eye(6)], -1)
        pulls = (np.where(views.seen > 0.0, weights, 0.0) ** 2)[:, :, None, None] * rates
        information = np.einsum("enik,enil->kl", pulls, rates)
        taken = np.linalg.solve(information, np.einsum("enik,enil->kl", pulls, bends))
        taken = taken * (self.share * self._unknown)
        return np.asarray(taken @ taken.T)

    @property
    def _unknown(self) -> Array:
        """How much of the motion (6,) about this picture is not known: after a loss all of it."""
        if self._told is not None:
            return np.asarray(self._told.unknown + _ABOUT / self.share * np.abs(self._twist))
        if self._X_C0C is None:
            return np.abs(self._fastest)
        return np.abs((_UNKNOWN if self._before.any() else _HALF) * self._twist)

    def foresee(self, number: int, X_C0C: Array | None, motion: Array) -> None:
        """Picture ``number`` comes: the one before was taken at ``X_C0C`` after ``motion``; None: there was
        none, or it was lost, and nothing is known.
        """
        self._X_C0C = X_C0C
        self._told = self._motions.get(number)
        self._before = _twist(motion) if X_C0C is not None else np.zeros(6)
        self._twist = self._before if self._told is None else self._told.twist

    def moved(self, X_C0C: Array) -> None:
        """This picture was taken about at ``X_C0C``."""
        if self._learns and self._X_C0C is not None:
            now = _twist(se3.inverse(self._X_C0C) @ X_C0C)
            if np.linalg.norm(now) > np.linalg.norm(self._fastest):
                self._fastest = now
            if self._told is None:
                before = self._before if self._before.any() else now
                self._twist = now + 0.5 * (now - before)  # at the picture, not between it and the last

    def straight(self, eye: CameraModel, rays: Array, points_C: Array) -> Array:
        """``rays`` (n, 2) of ``points_C`` (n, 3) as the whole picture would show them at its middle row's
        time.
        """
        return rays - self._bend(eye, rays, points_C) if self.share else rays

    def bent(self, eye: CameraModel, rays: Array, points_C: Array) -> Array:
        """The inverse: ``rays`` (n, 2) as the rows show them."""
        return rays + self._bend(eye, rays, points_C) if self.share else rays

    @property
    def taken_out(self) -> TakenOut:
        """What is taken out of this picture."""
        return TakenOut(self._twist, self.share)

    def learn(
        self, eyes: tuple[CameraModel, CameraModel], views: "PointViews", kept: TakenOut, noise_px: float
    ) -> None:
        """Learn from what both eyes missed points by, after the pose was found. The keyframe that showed them
        had moved as well, and ``kept`` was taken out of it; of two that move alike nothing is learnt.
        """
        if not self._learns or len(views.points_C) < _LEAST_POINTS or not self._twist.any():
            return
        since = np.stack([self._since(eye, rays) for eye, rays in zip(eyes, views.rays, strict=True)])
        now, then = (
            views.alone(since[:, :, None] * _moves(eyes, views.points_C, twist))
            for twist in (self._twist, kept.twist)
        )
        axes = np.stack([views.alone(_moves(eyes, views.points_C, axis)) for axis in np.eye(6)], axis=1)
        seen, *_ = np.linalg.lstsq(axes, now - then, rcond=None)
        alone = now - then - axes @ seen  # a pose takes the rest upon itself
        bent = views.alone(views.errors_px) + self.share * now - kept.share * then
        self._information += float(alone @ alone) / noise_px**2
        self._sum += float(alone @ bent) / noise_px**2
        found = self._sum / max(self._information, 1e-12)
        sure = self._known or abs(found) * self._information**0.5 > _SURE
        self.share = found if sure and _LEAST_SHARE < found < _MOST_SHARE else 0.0

    def _bend(self, eye: CameraModel, rays: Array, points_C: Array) -> Array:
        since = self.share * self._since(eye, rays)
        return np.asarray(since[:, None] * _rates(eye, points_C, self._twist))

    def _since(self, eye: CameraModel, rays: Array) -> Array:
        """When each ray's row is read (n,), from −½ to ½ of the readout."""
        row = eye.K[1, 1] * rays[:, 1] + eye.K[1, 2]
        return np.asarray((row - 0.5 * (self._height - 1)) / self._height)


class PlacedPicture(NamedTuple):
    """Picture ``number``, taken at ``capture_ns`` from ``X_C0C`` in map ``segment``."""

    number: int
    capture_ns: int
    segment: int
    X_C0C: Array


def motions(placed: Sequence[PlacedPicture]) -> dict[int, PictureMotion]:
    """How the camera moved about pictures that stand next to each other, by their numbers, in intervals of
    the usual length: the mean of before and after, and of what was seen from one side alone less is known.
    """
    steps = {
        one.number: (_twist(se3.inverse(one.X_C0C) @ other.X_C0C), other.capture_ns - one.capture_ns)
        for one, other in pairwise(placed)
        if other.number == one.number + 1 and other.segment == one.segment
    }
    usual_ns = float(np.median([after_ns for _, after_ns in steps.values()])) if steps else 0.0
    ways = {number: twist * (usual_ns / max(after_ns, 1)) for number, (twist, after_ns) in steps.items()}
    found = {}
    for number in sorted(ways.keys() | {number + 1 for number in ways}):
        before, after = ways.get(number - 1), ways.get(number)
        if before is not None and after is not None:
            found[number] = PictureMotion(0.5 * (before + after), 0.5 * _STEADY * np.abs(after - before))
        elif after is not None:
            further = ways.get(number + 1, 2.0 * after)
            found[number] = PictureMotion(after, 0.5 * np.abs(further - after))
        elif before is not None:
            further = ways.get(number - 2, 2.0 * before)
            found[number] = PictureMotion(before, 0.5 * np.abs(before - further))
    return found


def _twist(motion: Array) -> Array:
    return np.concatenate([motion[:3, 3], se3.log_so3(motion[:3, :3])])


def _moves(eyes: tuple[CameraModel, CameraModel], points_C: Array, twist: Array) -> Array:
    """The same in pixels of both eyes (2, n, 2)."""
    return np.stack([_rates(eye, points_C, twist) * (eye.K[0, 0], eye.K[1, 1]) for eye in eyes])


def _rates(eye: CameraModel, points_C: Array, twist: Array) -> Array:
    """How the rays (n, 2) of points (n, 3) move while the camera makes ``twist`` (6,), in its own axes."""
    moved = -(twist[:3] + np.cross(twist[3:], points_C)) @ eye.X_CE[:3, :3]
    at = se3.apply(se3.inverse(eye.X_CE), points_C)
    return np.asarray((moved[:, :2] - at[:, :2] / at[:, 2:] * moved[:, 2:]) / at[:, 2:])
