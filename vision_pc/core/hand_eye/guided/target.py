"""The calibration marker seen from rest: several pairs, one robust pose with covariance and corners."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.config.vision import LookSettings, MarkerSettings, ObjectMarkerSettings
from vision_pc.core.perception.look import observe, robust_mean
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, Image, StereoPair


class TargetLook(NamedTuple):
    """The calibration marker in the camera: X_CP (4, 4) and its ``covariance`` (6, 6).

    ``corners_left`` (4, 2) px: mean. ``X_CM``: the tool marker, where it was seen too. ``seen`` of ``frames``
    pairs showed the marker; ``last`` is the newest observation, whose estimate of the right eye's offset the
    next look starts from.
    """

    X_CP: Array
    covariance: Array
    corners_left: Array
    X_CM: Array | None
    frames: int
    seen: int
    last: FrameObservation


def target_settings(markers: MarkerSettings, settings: GuidedSettings) -> MarkerSettings:
    """``markers`` with the calibration marker as the one object.

    Raises RequestRefused (``refused.hand_eye.marker_id``) when the tool carries that number.
    """
    if settings.marker_id == markers.tool.id:
        raise RequestRefused("refused.hand_eye.marker_id", f"marker {settings.marker_id} is the tool's")
    target = ObjectMarkerSettings.model_construct(
        id=settings.marker_id, size_m=settings.marker_size_m, x_m=0.0, y_m=0.0
    )
    return markers.model_copy(update={"dictionary": settings.dictionary, "object": (target,)})


def look_at_target(
    pairs: Sequence[StereoPair],
    camera: CameraCalibration,
    markers: MarkerSettings,
    looks: LookSettings,
    settings: GuidedSettings,
    previous: FrameObservation | None = None,
    expected: frozenset[int] = frozenset(),
) -> TargetLook:
    """The marker as ``pairs``, taken at rest, show it; ``markers`` as of ``target_settings``.

    ``expected``: numbers of other markers that may be in view.

    Raises MeasurementFailed: ``measurement.hand_eye.wrong_marker`` when another marker is there in its place,
    ``.marker_not_seen`` when it is seen in too few pairs.
    """
    if previous is not None:  # the hand has moved since: only the right eye's offset still holds
        previous = previous._replace(X_CM=None, X_CO=None, markers=())
    observations = []
    for pair in pairs:
        previous = observe(pair, camera, markers, previous)
        observations.append(previous)
    seen = [o for o in observations if o.X_CO is not None]
    needed = min(settings.minimum_frames, len(pairs))
    if previous is None or len(seen) < needed:
        _refuse(pairs, len(seen), needed, expected | markers.sizes.keys(), settings)
    measured = [(o.X_CO, o.cov_CO, o.bias_CO) for o in observations]
    mean, count = robust_mean(measured, needed, "object", looks.huber_sigmas)
    corners = [m.corners_left for o in seen for m in o.markers if m.marker_id == settings.marker_id]
    tools = [o.X_CM for o in observations if o.X_CM is not None]
    assert previous is not None
    return TargetLook(
        mean.X,
        mean.noise + mean.bias,
        np.asarray(np.median(corners, axis=0)),
        tools[-1] if tools else None,
        len(pairs),
        count,
        previous,
    )


def _refuse(
    pairs: Sequence[StereoPair], seen: int, needed: int, expected: frozenset[int], settings: GuidedSettings
) -> None:
    counts = f"marker {settings.marker_id} seen in {seen} of {len(pairs)} pictures, {needed} are wanted"
    others = sorted(markers_in(pairs[-1].left, settings.dictionary) - expected) if pairs else []
    if seen == 0 and others:
        numbers = ", ".join(map(str, others))
        raise MeasurementFailed("measurement.hand_eye.wrong_marker", f"{counts}; seen instead: {numbers}")
    raise MeasurementFailed("measurement.hand_eye.marker_not_seen", counts)


def markers_in(image: Image, dictionary: str) -> set[int]:
    """The numbers of all markers of ``dictionary`` (OpenCV's name) in one picture."""
    codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    _, ids, _ = cv2.aruco.ArucoDetector(codes).detectMarkers(image)
    return set() if ids is None else {int(number) for number in ids.ravel()}
