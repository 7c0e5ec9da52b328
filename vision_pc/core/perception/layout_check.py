"""Whether the object's markers are where the configuration has them: each against where the others say it is.

Three markers or more are redundant. In the object's plane each one shows where it is and how it is turned.
All but one fix the plane figure (a shift and a turn), which says where that one should be.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vision_pc.config.vision import MarkerSettings
from vision_pc.core.se3 import Array, nearest_rotation
from vision_pc.core.types import FrameObservation, MarkerObservation, MisplacedMarker

_SIGMAS = 4.0  # [D] of what hanging, printing and lens explain
_LEAST = 3  # [D] markers: with two, nothing says which of them is wrong
_FLAT = 0.1  # [D] of their extent along that line
_PIXELS = 0.2  # [E] of a marker's middle: edges, lens


class _PlacesInPlane(NamedTuple):
    """How far markers are ``off`` the layout (n, 3): x and y of O (m), turn about z (rad); ``std`` (n, 3).
    ``layout`` (n, 2): where the configuration has it."""

    off: Array
    std: Array
    layout: Array


def misplaced_marker(
    markers: Sequence[MarkerObservation], focal_px: float, settings: MarkerSettings
) -> MisplacedMarker | None:
    """The marker of the object that the others contradict by more than 4 σ while they agree; None for none,
    where fewer than three are seen, or they hang in a line. ``focal_px``: of the left eye.
    """
    known = {one.id: (one.x_m, one.y_m) for one in settings.object}
    seen = [one for one in markers if one.marker_id in known]
    layout = np.array([known[one.marker_id] for one in seen]).reshape(-1, 2)
    if len(seen) < _LEAST or _in_a_line(layout):
        return None
    places = _places(seen, layout, focal_px, settings)
    tried = [_without(places, k) for k in range(len(seen))]
    suspect = int(np.argmin([chi2 for chi2, _, _ in tried]))  # the others agree best without it
    _, off, covariance = tried[suspect]
    if float(off @ np.linalg.solve(covariance, off)) <= _SIGMAS**2:
        return None
    return MisplacedMarker(seen[suspect].marker_id, off, np.sqrt(np.diag(covariance)))


def misplaced_in_most(observations: Sequence[FrameObservation]) -> MisplacedMarker | None:
    """The marker that more than half of the frames question, with the mean of what they say, or None."""
    doubts = [one.misplaced for one in observations if one.misplaced is not None]
    if not doubts:
        return None
    usual, times = Counter(one.marker_id for one in doubts).most_common(1)[0]
    if 2 * times <= len(observations):
        return None
    alike = [one for one in doubts if one.marker_id == usual]
    # no mean over frames makes a layout better known
    off, std = (np.mean([getattr(one, name) for one in alike], axis=0) for name in ("off_m", "std_m"))
    return MisplacedMarker(usual, off, std)


def _in_a_line(layout: Array) -> bool:
    """Whether the places (n, 2) leave open how their plane is turned about the line that they lie along."""
    along, across = np.linalg.svd(layout - layout.mean(axis=0), compute_uv=False)
    return bool(across < _FLAT * along)


def _places(
    seen: Sequence[MarkerObservation], layout: Array, focal_px: float, settings: MarkerSettings
) -> _PlacesInPlane:
    """Each marker by its own corners alone: a pose of the whole would tilt until a wrong layout fits."""
    middles = np.array([one.X_CA[:3, 3] for one in seen])
    centre = middles.mean(axis=0)
    there = np.column_stack([layout - layout.mean(axis=0), np.zeros(len(seen))])
    R_OC = nearest_rotation(there.T @ (middles - centre))  # that takes the middles nearest to the layout
    off, std = np.zeros((len(seen), 3)), np.zeros((len(seen), 3))
    scale = float(np.hypot(settings.print_size_std, settings.focal_std))  # of a marker's own range
    for k, one in enumerate(seen):
        off[k, :2] = (R_OC @ (middles[k] - centre))[:2] - (layout[k] - layout.mean(axis=0))
        R_OA = R_OC @ one.X_CA[:3, :3]
        off[k, 2] = np.arctan2(R_OA[1, 0] - R_OA[0, 1], R_OA[0, 0] + R_OA[1, 1])
        place = float(np.hypot(settings.placement_std_m, _PIXELS * float(middles[k, 2]) / focal_px))
        std[k, :2] = np.hypot(place, scale * np.abs(R_OC @ middles[k])[:2])
        std[k, 2] = np.sqrt(2.0) * place / one.size
    return _PlacesInPlane(off, std, layout)


def _without(places: _PlacesInPlane, k: int) -> tuple[float, Array, Array]:
    """(χ² of the others' own figure, how far marker ``k`` is off it (2,), m, its covariance (2, 2))."""
    others = np.arange(len(places.off)) != k
    rows = np.concatenate([_slopes(at) for at in places.layout[others]])
    weights = places.std[others].ravel() ** -2.0
    covariance = np.linalg.inv(rows.T @ (weights[:, None] * rows))
    figure = covariance @ (rows.T @ (weights * places.off[others].ravel()))
    left = places.off[others].ravel() - rows @ figure
    here = _slopes(places.layout[k])[:2]
    off = places.off[k, :2] - here @ figure
    return float(left @ (weights * left)), off, np.diag(places.std[k, :2] ** 2) + here @ covariance @ here.T


def _slopes(at: Array) -> Array:
    """x, y and turn (3, 3) of what sits ``at`` (2,), by a small shift and turn of the figure."""
    return np.array([[1.0, 0.0, -at[1]], [0.0, 1.0, at[0]], [0.0, 0.0, 1.0]])
