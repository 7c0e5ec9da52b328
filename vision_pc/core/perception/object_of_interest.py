"""Tool marker and object of interest in one frame: one joint solution from all visible corners of both
eyes.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np

from vision_pc.config.vision import MarkerSettings
from vision_pc.core import se3
from vision_pc.core.perception import stereo_pose
from vision_pc.core.perception.markers import AMBIGUOUS_BELOW, Sighting, corner_points
from vision_pc.core.perception.stereo_pose import BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoOffset


class LocatedBody(NamedTuple):
    """A posed body: X_CM or X_CO, its whole covariance, and the part of it that frames share."""

    X: Array
    covariance: Array
    bias: Array


class LocatedScene(NamedTuple):
    """Tool and object as far as they were seen, the right eye's offset after this frame, and refusals."""

    tool: LocatedBody | None
    object: LocatedBody | None
    offset: StereoOffset
    refused: Counter[str]


def locate(
    sightings: list[Sighting],
    camera: CameraCalibration,
    settings: MarkerSettings,
    priors: Priors,
    previous: tuple[Array | None, Array | None] = (None, None),
) -> LocatedScene:
    """Tool and object of interest from this frame's ``sightings``.

    The object's pose comes from all corners of its markers at once, or from any one marker. A marker that
    disagrees with the others is left out (``residual``). A pose whose planar twin explains the corners as
    well is decided by ``previous`` (X_CM, X_CO), or refused (``ambiguous``).
    """
    refused: Counter[str] = Counter()
    tools = [s for s in sightings if s.observation.marker_id == settings.tool.id]
    parts = [s for s in sightings if s.observation.marker_id != settings.tool.id]
    tool_start = _decided(tools[0], previous[0], refused) if tools else None
    object_start, parts = _object_start(parts, camera, settings, priors, previous[1], refused)
    views, starts = [], []
    if tool_start is not None:
        views.append(tools[0].view)
        starts.append(tool_start)
    if object_start is not None:
        views.append(_object_view(parts, settings))
        starts.append(object_start)
    if not views:
        return LocatedScene(None, None, priors.offset, refused)
    solution = stereo_pose.solve(views, starts, camera, priors)
    bodies = []
    for X, covariance, bias in zip(solution.X_CA, solution.covariances, solution.biases, strict=True):
        lens = lens_covariance(X, settings, priors.radial_std)
        bodies.append(LocatedBody(X, covariance + lens, bias + lens))
    if object_start is not None and settings.placement_std_m > 0.0:
        bodies[-1] = _misplaced(bodies[-1], len(parts), settings)
    return LocatedScene(
        bodies[0] if tool_start is not None else None,
        bodies[-1] if object_start is not None else None,
        _floored(solution.offset, priors, settings.offset_floor_px),
        refused,
    )


def marker_in_object(marker_id: int, settings: MarkerSettings) -> Array:
    """X_OA: where the marker sits in the object of interest."""
    part = next(marker for marker in settings.object if marker.id == marker_id)
    return se3.transform(np.eye(3), (part.x_m, part.y_m, 0.0))


def _decided(sighting: Sighting, previous: Array | None, refused: Counter[str]) -> Array | None:
    """X_CA of the planar solution to believe, None when nothing can tell."""
    best = sighting.observation.X_CA
    if sighting.observation.flip_margin >= AMBIGUOUS_BELOW:
        return best
    if previous is None:
        refused["ambiguous"] += 1
        return None
    return min((best, sighting.other), key=lambda X: se3.angle_between(X[:3, :3], previous[:3, :3]))


def _object_start(
    parts: list[Sighting],
    camera: CameraCalibration,
    settings: MarkerSettings,
    priors: Priors,
    previous: Array | None,
    refused: Counter[str],
) -> tuple[Array | None, list[Sighting]]:
    """X_CO to start the joint solution from, and the markers that agree with it."""
    if not parts:
        return None, parts
    surest = max(parts, key=lambda s: s.observation.flip_margin)
    X_OA = marker_in_object(surest.observation.marker_id, settings)
    X_AO = se3.inverse(X_OA)
    if len(parts) == 1:
        X_CA = _decided(surest, None if previous is None else previous @ X_OA, refused)
        return (None if X_CA is None else X_CA @ X_AO), parts
    starts = [surest.observation.X_CA @ X_AO]
    if surest.observation.flip_margin < AMBIGUOUS_BELOW:
        starts.append(surest.other @ X_AO)
    view = _object_view(parts, settings)
    best = min((stereo_pose.solve([view], [X], camera, priors) for X in starts), key=lambda s: s.chi2[0])
    if best.residuals_px[0] <= settings.residual_limit_px:
        return best.X_CA[0], parts
    refused["residual"] += 1
    return _object_start(_without_the_stranger(parts, settings), camera, settings, priors, previous, refused)


def _without_the_stranger(parts: list[Sighting], settings: MarkerSettings) -> list[Sighting]:
    """``parts`` without the marker whose own idea of X_CO is farthest from the others' (of two: the less
    certain).
    """
    if len(parts) == 2:
        return [min(parts, key=lambda s: float(np.trace(s.observation.covariance)))]
    places = [marker_in_object(part.observation.marker_id, settings) for part in parts]
    centres = [
        (part.observation.X_CA @ se3.inverse(X_OA))[:3, 3] for part, X_OA in zip(parts, places, strict=True)
    ]
    distances = np.linalg.norm(np.array(centres) - np.median(centres, axis=0), axis=1)
    stranger = int(np.argmax(distances))
    return [part for k, part in enumerate(parts) if k != stranger]


def _object_view(parts: list[Sighting], settings: MarkerSettings) -> BodyView:
    """All corners of ``parts`` as points of O."""
    points = [
        se3.apply(marker_in_object(seen.marker_id, settings), corner_points(seen.size))
        for seen in (part.observation for part in parts)
    ]
    return BodyView(
        np.concatenate(points),
        np.concatenate([part.view.rays for part in parts], axis=1),
        np.concatenate([part.view.weights for part in parts], axis=1),
    )


def lens_covariance(X: Array, settings: MarkerSettings, radial_std: float) -> Array:
    """What errors of the focal length and of k1, which both eyes share, do: the one stretches every range,
    the other moves what is far from the middle of the picture, radially.

    An error of the principal point is left out: it turns all directions alike, so it is no error of one body
    but of what two differ by in depth (``look_then_move.error_covariance``).
    """
    covariance = np.diag([0.0, 0.0, (settings.focal_std * float(X[2, 3])) ** 2, 0.0, 0.0, 0.0])
    if radial_std > 0.0:
        across = X[:2, 3]
        moved = radial_std * float(across @ across) / float(X[2, 3]) ** 2 * across
        covariance[:2, :2] += np.outer(moved, moved)
    return covariance


def _misplaced(body: LocatedBody, markers: int, settings: MarkerSettings) -> LocatedBody:
    """The object with what its ``markers`` do to its middle when each was put a little beside its place."""
    off = np.zeros((6, 6))
    off[:3, :3] = settings.placement_std_m**2 / markers * np.eye(3)
    return body._replace(covariance=body.covariance + off, bias=body.bias + off)


def _floored(after: StereoOffset, priors: Priors, floor_px: float) -> StereoOffset:
    """``after``, never more certain than the floor: lens and print errors do not average out over frames.
    ``before``, where it is known from more than frames.
    """
    before = priors.offset
    if priors.known:
        return before
    return after._replace(
        std_x_px=min(max(after.std_x_px, floor_px), before.std_x_px),
        std_y_px=min(max(after.std_y_px, floor_px), before.std_y_px),
    )
