"""Doubt: something was seen elsewhere than it must be, and nobody has answered that yet.

Two looks with the arm at rest between them must agree, and a look after a drive must agree with what
odometry or the calibration says of that drive: along all three axes and in attitude. Where they do not, the
object moves, or the marker on the tool, the camera or odometry is wrong. That stays, over any number of
drives, until looks at rest agree for ``REST_S``, a new calibration sees the object stand still, or a person
says so.
"""

from collections.abc import Hashable
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from vision_pc.core.se3 import Array, hat, local
from vision_pc.core.types import Contradiction, Look

REST_S = 30.0  # as long as a drive: what moves too slowly to be seen in it ends inside the tolerance
_REPEATS = 2e-4**2 * np.diag([1.0] * 3 + [0.0] * 3)  # [M] m²: looks at what stands still differ by 0.1 mm
_LENSES = 4e-3**2 * np.diag([0.0] * 3 + [1.0] * 3)  # [M] rad²: 12 attitudes of looks, seeds 78001 to 78003
_STALE = 0.003  # [D] m or rad: more than an arm at rest creeps
_CHI_SQUARE = 25.0  # [S] 1.5 of 100,000 honest differences of three coordinates are larger


class DoubtOf(StrEnum):
    """What was seen elsewhere: the object (or odometry is wrong), or the tool's marker in the camera."""

    OBJECT = "object"
    TOOL = "tool"


class UncertainPose(NamedTuple):
    """A pose X (4, 4) in the camera, with its covariance (6, 6)."""

    X: Array
    covariance: Array


def object_of(look: Look) -> UncertainPose:
    """The object as ``look`` saw it; lenses turn its attitude, from each distance differently."""
    return UncertainPose(look.X_CO, look.cov_CO + _REPEATS + _LENSES)


def tool_of(look: Look) -> UncertainPose:
    """The tool's marker as ``look`` saw it."""
    return UncertainPose(look.X_CM, look.cov_CM + _REPEATS)


def carried(sight: UncertainPose, X_KC: Array, p_variance: Array, attitude_variance: float) -> UncertainPose:
    """``sight``, seen from C, as it must be seen from K: by the motion X_KC of the camera, which is known to
    ``p_variance`` (3, 3) m² and ``attitude_variance`` rad².
    """
    X, turn = X_KC @ sight.X, np.kron(np.eye(2), X_KC[:3, :3])
    lever = hat(X[:3, 3])
    covariance = turn @ sight.covariance @ turn.T
    covariance[:3, :3] += p_variance + attitude_variance * lever @ lever.T
    covariance[3:, 3:] += attitude_variance * np.eye(3)
    return UncertainPose(X, covariance)


def doubt_of(
    what: DoubtOf, predicted: UncertainPose, seen: UncertainPose, time_ns: int
) -> Contradiction | None:
    """The doubt where ``seen`` and ``predicted`` differ by more than both explain; None where they agree."""
    off = local(predicted.X, seen.X)
    covariance = predicted.covariance + seen.covariance
    for part in (slice(0, 3), slice(3, 6)):
        if float(off[part] @ np.linalg.solve(covariance[part, part], off[part])) > _CHI_SQUARE:
            return Contradiction(
                what, float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:])), time_ns
            )
    return None


def tool_doubt(first: Look, last: Look) -> Contradiction | None:
    """The doubt where the tool's marker is not where it was in the camera, which both ride on the arm."""
    return doubt_of(DoubtOf.TOOL, tool_of(first), tool_of(last), last.time_ns)


class DoubtKeeper:
    """The one place that keeps doubt. Its time is that of the looks; nothing here reads a clock."""

    def __init__(self) -> None:
        self.doubt: Contradiction | None = None
        self._base: Look | None = None
        self._since: Hashable = None

    def looked(self, look: Look, since: Hashable) -> Look:
        """``look`` with the doubt that stands, after it was compared with the looks before it.

        They are compared while ``since``, the target and how many motions there were, is the same. One that
        agrees with another that is ``REST_S`` older, and was taken after what raised the doubt, ends it.
        """
        base = self._base if since == self._since else None
        crept = np.zeros(6) if base is None else local(base.X_BT, look.X_BT)
        far2, turn2 = (float(part @ part) for part in np.split(crept, 2))
        if base is None or not max(far2, turn2) < _STALE**2:  # another client has moved it
            self._base, self._since = look, since
            return look._replace(doubt=self.doubt)
        here = carried(object_of(base), np.eye(4), far2 * np.eye(3), turn2)
        found = tool_doubt(base, look) or doubt_of(DoubtOf.OBJECT, here, object_of(look), look.time_ns)
        if found is not None:
            self.raised(found)
            self._base = look
        elif 1e-9 * (look.time_ns - base.time_ns) >= REST_S:
            self.answered()
        return look._replace(doubt=self.doubt)

    def raised(self, doubt: Contradiction | None) -> None:
        """Keep a doubt; of two, how far the farther went."""
        if doubt is None:
            return
        before = self.doubt or doubt
        far, turn = max(doubt.shift_m, before.shift_m), max(doubt.turn_rad, before.turn_rad)
        self.doubt = doubt._replace(shift_m=far, turn_rad=turn)
        self._base = None

    def answered(self) -> None:
        """Nothing is in doubt any longer: a calibration saw the object stand still, or a person says so."""
        self.doubt = None
