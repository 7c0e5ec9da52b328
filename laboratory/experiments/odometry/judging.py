"""What odometry told of a sequence against the truth: errors over what was told of them, and what was wrong
and not told.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.shell.cameras.sequence import SequenceResult

FLOOR_M, FLOOR_RAD = 1e-3, np.radians(0.1)
"""Errors below these are nobody's harm, whatever was told."""
SIGMAS = 3.0
GROSS_M = 0.03
"""An error that is wrong without any σ; half a pixel of disparity makes 15 mm of a metre."""
FREEDOM = 6


class Judged(NamedTuple):
    """``located`` poses, ``wrong`` ones that nobody told of, ``gross`` errors, the greatest error m, the
    median standard deviation told m, and the mean error² over variance (6: honest); NaN where there is none.
    """

    located: int
    wrong: int
    gross: int
    worst_m: float
    told_m: float
    nees: float


def judged(result: SequenceResult, true: Array) -> Judged:
    """``result`` against the ``true`` poses (n, 4, 4) of its pairs, each map from its own first pair on, and
    where maps were joined also from the first map's.
    """
    firsts: dict[int, Array] = {}
    held: set[int] = set()
    found: list[tuple[Array, Array]] = []
    for record in result.records:
        if record.pose is None or record.segment is None:
            continue
        here = true[record.frame_id]
        if record.segment not in firsts:
            firsts[record.segment] = here @ se3.inverse(record.pose.X_C0C)
            continue
        error = se3.local(se3.inverse(firsts[record.segment]) @ here, record.pose.X_C0C)
        found.append((error, record.pose.covariance))
        held.add(record.segment)
    located = len(found) + len(held)  # a map of one pair tells no place
    return _summed(located, found)


def _summed(located: int, found: Sequence[tuple[Array, Array]]) -> Judged:
    if not found:
        return Judged(located, 0, 0, 0.0, float("nan"), float("nan"))
    away = [float(np.linalg.norm(error[:3])) for error, _ in found]
    told = [float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])) for _, covariance in found]
    nees = [float(error @ np.linalg.solve(covariance, error)) for error, covariance in found]
    return Judged(
        located,
        sum(is_wrong(*one) for one in found),
        sum(length > GROSS_M for length in away),
        max(away),
        float(np.median(told)),
        float(np.mean(nees)),
    )


def is_wrong(error: Array, covariance: Array) -> bool:
    """Whether ``error`` (6,) is beyond the floor and beyond what was told, in place or in rotation."""
    parts = ((slice(0, 3), FLOOR_M), (slice(3, 6), FLOOR_RAD))
    return any(_beyond(error[part], covariance[part, part], floor) for part, floor in parts)


def _beyond(error: Array, covariance: Array, floor: float) -> bool:
    size = float(np.linalg.norm(error))
    if size <= floor:
        return False
    along = error / size
    return size > SIGMAS * float(np.sqrt(along @ covariance @ along))


def gross(found: Sequence[tuple[int, Array]], true: Array) -> tuple[int, float]:
    """How many of ``found`` (pair, X_C0C) are grossly off, from the first of them on; the greatest error m.

    Of a peer that tells neither losses of its map nor any σ: all its poses count as one trajectory.
    """
    if not found:
        return 0, 0.0
    begin = true[found[0][0]] @ se3.inverse(found[0][1])
    away = [float(np.linalg.norm((begin @ X)[:3, 3] - true[k][:3, 3])) for k, X in found]
    return sum(length > GROSS_M for length in away), max(away)
