"""Pictures for people: the left eye's picture with what was detected drawn into it."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoPair

_GREEN, _ORANGE = (80, 220, 80), (40, 150, 255)
_AXIS_M = 0.06
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # level 3 takes half as long again for an eighth less


def annotated(
    pair: StereoPair, observation: FrameObservation, calibration: CameraCalibration
) -> NDArray[np.uint8]:
    """The left picture (height, width, 3) BGR with outlines, numbers, and the frames M and O."""
    picture: Any = cv2.cvtColor(pair.left, cv2.COLOR_GRAY2BGR)
    for marker in observation.markers:
        corners = np.round(marker.corners_left).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(picture, [corners], True, _GREEN, 2, cv2.LINE_AA)
        cv2.circle(picture, [int(v) for v in corners[0, 0]], 5, _ORANGE, 2, cv2.LINE_AA)
        at = [int(v) for v in corners[:, 0].max(axis=0)]
        cv2.putText(picture, f"{marker.marker_id}", at, cv2.FONT_HERSHEY_SIMPLEX, 0.6, _GREEN, 1, cv2.LINE_AA)
    for X in (observation.X_CM, observation.X_CO):
        if X is not None:
            _axes(picture, X, calibration)
    return np.asarray(picture, dtype=np.uint8)


def png(picture: NDArray[np.uint8]) -> bytes:
    """``picture`` as PNG. Raises MeasurementFailed (``measurement.no_picture``) when it cannot be written."""
    written, data = cv2.imencode(".png", picture, _PNG)
    if not written:
        raise MeasurementFailed("measurement.no_picture", "the picture could not be written as PNG")
    return bytes(data)


def _axes(picture: Any, X: Array, calibration: CameraCalibration) -> None:
    eye = calibration.left
    if X[2, 3] <= _AXIS_M:
        return
    rvec, _ = cv2.Rodrigues(X[:3, :3])
    cv2.drawFrameAxes(picture, eye.K, eye.distortion.reshape(-1, 1), rvec, X[:3, 3].reshape(3, 1), _AXIS_M, 2)
