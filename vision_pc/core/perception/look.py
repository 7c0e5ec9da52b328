"""A frame observed, and several frames of an arm at rest combined into one robust look."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.vision import LookSettings, MarkerSettings
from vision_pc.core import se3
from vision_pc.core.perception import markers, object_of_interest
from vision_pc.core.perception.layout_check import misplaced_in_most, misplaced_marker
from vision_pc.core.perception.markers import Detected, Region, Sighting
from vision_pc.core.perception.stereo_pose import Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraCalibration,
    CameraFrame,
    FrameObservation,
    Image,
    Look,
    StereoOffset,
    StereoPair,
)

_ROBUST_ROUNDS = 10
_CHI2_MEDIAN_6 = 5.348  # median of χ² with six degrees of freedom


class MeanPose(NamedTuple):
    """A robust mean pose, the covariance of its noise and of a single frame's, and the bias all frames
    share.
    """

    X: Array
    noise: Array
    frame_noise: Array
    bias: Array


def robust_mean(
    measured: list[tuple[Array | None, Array | None, Array | None]],
    needed: int,
    what: str,
    huber: float,
    reason: str = "not_seen",
) -> tuple[MeanPose, int]:
    """The mean of the poses that were measured, and how many they are; raises when fewer than ``needed``.

    Raises MeasurementFailed: ``measurement.{what}_{reason}``.
    """
    seen = [(X, C, B) for X, C, B in measured if X is not None and C is not None and B is not None]
    if len(seen) < needed:
        raise MeasurementFailed(
            f"measurement.{what}_{reason}",
            f"look: {what} seen in {len(seen)} of {len(measured)} frames, at least {needed} are wanted"
            + ("" if reason == "not_seen" else f"; elsewhere {reason.replace('_', ' ')}"),
        )
    information = [np.asarray(np.linalg.inv(C), dtype=np.float64) for _, C, _ in seen]
    X = _medoid([pose for pose, _, _ in seen], information)
    weights, spread = np.ones(len(seen)), 1.0
    for _ in range(_ROBUST_ROUNDS):
        deltas = [se3.local(X, pose) for pose, _, _ in seen]
        noise_distances = np.array(
            [float(d @ np.linalg.solve(C - B, d)) for d, (_, C, B) in zip(deltas, seen, strict=True)]
        )
        spread = max(1.0, float(np.median(noise_distances)) / _CHI2_MEDIAN_6)
        weights = np.minimum(1.0, huber * np.sqrt(6.0 * spread / np.maximum(noise_distances, 1e-12)))
        total = np.sum([w * L for w, L in zip(weights, information, strict=True)], axis=0)
        pull = np.sum([w * L @ d for w, L, d in zip(weights, information, deltas, strict=True)], axis=0)
        X = se3.retract(X, np.linalg.solve(total, pull))
    gains = [np.linalg.solve(total, w * L) for w, L in zip(weights, information, strict=True)]
    noise = spread * np.sum([G @ (C - B) @ G.T for G, (_, C, B) in zip(gains, seen, strict=True)], axis=0)
    bias = np.sum([G @ B for G, (_, _, B) in zip(gains, seen, strict=True)], axis=0)
    frame_noise = spread * np.mean([C - B for _, C, B in seen], axis=0)
    return MeanPose(X, noise, frame_noise, 0.5 * (bias + bias.T)), len(seen)


def _medoid(poses: list[Array], information: list[Array]) -> Array:
    """The pose with the least sum of (unsquared) distances to all others: a start that no outlier can
    pull.
    """

    def distance(X: Array) -> float:
        deltas = [se3.local(X, Y) for Y in poses]
        return sum(float(np.sqrt(d @ L @ d)) for d, L in zip(deltas, information, strict=True))

    return min(poses, key=distance)


_FULL_SEARCH_EVERY = 10  # own frames: so that a marker that comes into view is found while others are tracked
_REFUSED = frozenset({"edges", "residual", "wrong_size"})  # what was there and is to be looked at again


def observe(
    pair: StereoPair,
    camera: CameraCalibration,
    settings: MarkerSettings,
    previous: FrameObservation | None = None,
) -> FrameObservation:
    """What ``pair`` shows of tool and object of interest.

    ``previous`` is the frame before: where its markers were is searched first, its poses decide an
    ambiguous marker, its estimate of the right eye's offset is carried on.
    """
    priors = priors_after(previous, settings)
    detected, since_full_search = _found(pair, settings, previous)
    sightings, unfit = markers.sight(pair, detected.corners, camera, settings, priors)
    unfit |= dict.fromkeys(detected.repeated, "repeated_id")
    seen = FrameMarkers(sightings, detected.refused, unfit, since_full_search)
    return observation_of(pair, seen, camera, settings, priors, previous)


def priors_after(previous: FrameObservation | None, settings: MarkerSettings) -> Priors:
    """What is taken for granted about the frame after ``previous``, the offset as it was last estimated."""
    offset = StereoOffset(0.0, 0.0, settings.offset_std_px, settings.offset_std_px)
    if previous is not None and previous.offset is not None:
        offset = previous.offset
    corner, size, radial = settings.corner_std_px, settings.print_size_std, settings.radial_std
    if previous is None or previous.errors is None:
        return Priors(corner, size, offset, radial)
    return Priors(corner, size, offset, math.sqrt(previous.errors.covariance[6, 6]), known=True)


class FrameMarkers(NamedTuple):
    """The markers of one frame: those that passed every test, and what became of the others.

    ``refused`` counts what is no marker of ours, ``unfit`` says of those that are why they were refused.
    ``since_full_search``: frames since the whole picture was searched.
    """

    sightings: list[Sighting]
    refused: Counter[str]
    unfit: Mapping[int, str]
    since_full_search: int


def observation_of(
    frame: CameraFrame,
    seen: FrameMarkers,
    camera: CameraCalibration,
    settings: MarkerSettings,
    priors: Priors,
    previous: FrameObservation | None,
) -> FrameObservation:
    """What the markers ``seen`` in one frame say about tool and object."""
    known = (None, None) if previous is None else (previous.X_CM, previous.X_CO)
    scene = object_of_interest.locate(seen.sightings, camera, settings, priors, known)
    tool, target = scene.tool, scene.object
    found = tuple(sighting.observation for sighting in seen.sightings)
    focal_px = float(camera.left.K[0, 0])
    return FrameObservation(
        capture_ns=frame.capture_ns,
        frame_id=frame.frame_id,
        X_CM=None if tool is None else tool.X,
        cov_CM=None if tool is None else tool.covariance,
        bias_CM=None if tool is None else tool.bias,
        X_CO=None if target is None else target.X,
        cov_CO=None if target is None else target.covariance,
        bias_CO=None if target is None else target.bias,
        markers=found,
        rejected=dict(seen.refused + Counter(seen.unfit.values()) + scene.refused),
        offset=scene.offset if scene.tool or scene.object or previous is not None else None,
        missing_tool=_missing(tool, {settings.tool.id}, seen.sightings, seen.unfit),
        missing_object=_missing(
            target, {marker.id for marker in settings.object}, seen.sightings, seen.unfit
        ),
        since_full_search=seen.since_full_search,
        errors=None if previous is None else previous.errors,
        misplaced=misplaced_marker(found, focal_px, settings),
    )


def _missing(
    body: object_of_interest.LocatedBody | None,
    ids: set[int],
    sightings: list[Sighting],
    unfit: Mapping[int, str],
) -> str | None:
    """Why ``body``, which bears the markers ``ids``, has no pose; None when it has one."""
    if body is not None:
        return None
    if any(sighting.observation.marker_id in ids for sighting in sightings):
        return "ambiguous"
    reasons = {unfit.get(number) for number in ids}
    if "repeated_id" in reasons:
        return "seen_twice"
    return "wrong_size" if "wrong_size" in reasons else "not_seen"


def _found(
    pair: StereoPair, settings: MarkerSettings, previous: FrameObservation | None
) -> tuple[Detected, int]:
    """Rough corners in the left picture, and how many frames ago all of it was searched.

    Searched is around the last frame's markers if all of them are there again, else anywhere; so too after
    one was refused, which may have been for what was not yet known of the camera.

    Frames may have been skipped: what counts is how many were observed, not their numbers.
    """
    before = () if previous is None else previous.markers
    since = 0 if previous is None else previous.since_full_search + 1
    complete = len(before) == len(settings.sizes)
    refused = previous is not None and not _REFUSED.isdisjoint(previous.rejected)
    if before and (complete or (since < _FULL_SEARCH_EVERY and not refused)):
        region = _region(
            pair.left, np.concatenate([m.corners_left for m in before]), settings.region_margin_px
        )
        needed = frozenset(m.marker_id for m in before)
        detected = markers.detect(pair.left, settings, region, needed)
        if needed <= detected.corners.keys():
            return detected, since
    return markers.detect(pair.left, settings), 0


def _region(image: Image, corners: Array, margin: int) -> Region:
    height, width = image.shape
    x0, y0 = (corners.min(axis=0) - margin).astype(int)
    x1, y1 = (corners.max(axis=0) + margin).astype(int)
    return max(int(x0), 0), max(int(y0), 0), min(int(x1), width), min(int(y1), height)


def combine(
    observations: Sequence[FrameObservation], X_BT: Array, time_ns: int, settings: LookSettings
) -> Look:
    """The look that ``observations`` (all tried frames, also those that show nothing) amount to.

    Poses are averaged on SE(3), weighted with their covariances and by Huber's weights. Raises
    MeasurementFailed when the tool (``measurement.tool_not_seen``) or the object
    (``measurement.object_not_seen``) was seen in fewer frames than configured, or no frame was tried
    (``measurement.no_frames``). Where most frames showed a marker that could not be believed, the cause ends
    in ``_wrong_size``, ``_seen_twice`` or ``_ambiguous`` instead. A right eye too far off its calibration is
    ``measurement.camera_off_calibration``.
    """
    tried = len(observations)
    if tried == 0:
        raise MeasurementFailed("measurement.no_frames", "look: 0 frames arrived, at least 1 is wanted")
    _refuse_wild(observations[-1].offset, settings)
    tool_missing = [o.missing_tool for o in observations]
    target_missing = [o.missing_object for o in observations]
    tool = [(o.X_CM, o.cov_CM, o.bias_CM) for o in observations]
    target = [(o.X_CO, o.cov_CO, o.bias_CO) for o in observations]
    tool_mean, tool_seen = robust_mean(
        tool,
        _frames_required(settings, tool_missing),
        "tool",
        settings.huber_sigmas,
        usual_reason(tool_missing),
    )
    target_mean, target_seen = robust_mean(
        target,
        _frames_required(settings, target_missing),
        "object",
        settings.huber_sigmas,
        usual_reason(target_missing),
    )
    return Look(
        time_ns=time_ns,
        X_CM=tool_mean.X,
        X_CO=target_mean.X,
        X_BT=X_BT,
        frames=tried,
        failed_tool=tried - tool_seen,
        failed_object=tried - target_seen,
        cov_CM=settings.std_factor**2 * (tool_mean.noise + tool_mean.bias),
        cov_CO=settings.std_factor**2 * (target_mean.noise + target_mean.bias),
        frame_cov_CM=tool_mean.frame_noise,
        frame_cov_CO=target_mean.frame_noise,
        offset=observations[-1].offset,
        misplaced=misplaced_in_most(observations),
    )


def _refuse_wild(offset: StereoOffset | None, settings: LookSettings) -> None:
    if offset is not None and max(abs(offset.x_px), abs(offset.y_px)) > settings.offset_limit_px:
        raise MeasurementFailed(
            "measurement.camera_off_calibration",
            f"look: the right eye is off its calibration by {offset.x_px:+.2f} px across and "
            f"{offset.y_px:+.2f} px down, limit {settings.offset_limit_px:g} px",
        )


def _frames_required(settings: LookSettings, missing: Sequence[str | None]) -> int:
    """How many frames must show what was ``missing`` in others: more than those that tell a wrong size, which
    the left eye alone, where the right one failed, cannot tell.
    """
    return max(min(settings.minimum_frames, len(missing)), missing.count("wrong_size") + 1)


def usual_reason(missing: Iterable[str | None]) -> str:
    """The most frequent reason why what was ``missing`` in frames could not be believed, else ``not_seen``.

    A marker refused once is searched for again only every few frames, and counts as not seen between.
    """
    reasons = Counter(reason for reason in missing if reason is not None and reason != "not_seen")
    return reasons.most_common(1)[0][0] if reasons else "not_seen"
