"""Pictures for people: the left eye's picture with what was detected drawn into it."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoPair

_GREEN, _ORANGE, _WHITE, _BLACK = (80, 220, 80), (40, 150, 255), (255, 255, 255), (0, 0, 0)
_AXIS_M = 0.06
_LINE_PX = 24
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # level 3 takes half as long again for an eighth less


def annotated(
    pair: StereoPair, observation: FrameObservation, calibration: CameraCalibration, clearance_m: float
) -> NDArray[np.uint8]:
    """The left picture (height, width, 3) BGR with outlines, the frames M and O, and the error in words."""
    picture: Any = cv2.cvtColor(pair.left, cv2.COLOR_GRAY2BGR)
    for marker in observation.markers:
        corners = np.round(marker.corners_left).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(picture, [corners], True, _GREEN, 2, cv2.LINE_AA)
        cv2.circle(picture, [int(v) for v in corners[0, 0]], 5, _ORANGE, 2, cv2.LINE_AA)
        _write(picture, f"{marker.marker_id}", tuple(int(v) for v in corners[:, 0].max(axis=0)))
    for X in (observation.X_CM, observation.X_CO):
        if X is not None:
            _axes(picture, X, calibration)
    for row, line in enumerate(in_words(observation, clearance_m)):
        _write(picture, line, (16, 32 + row * _LINE_PX))
    return np.asarray(picture, dtype=np.uint8)


def in_words(observation: FrameObservation, clearance_m: float) -> list[str]:
    """What the picture's caption says, a line each."""
    lines = [f"frame {observation.frame_id}"]
    for name, X in (("tool", observation.X_CM), ("object", observation.X_CO)):
        if X is None:
            lines.append(f"{name}: not seen")
        else:
            x, y, z = 1e3 * X[:3, 3]
            lines.append(f"{name}: x {x:+.1f}  y {y:+.1f}  z {z:+.1f} mm")
    if observation.X_CM is not None and observation.X_CO is not None:
        e = 1e3 * (observation.X_CO[:3, 3] - observation.X_CM[:3, 3] - np.array([0.0, 0.0, clearance_m]))
        lines.append(f"error: x {e[0]:+.1f}  y {e[1]:+.1f}  z {e[2]:+.1f} mm")
    return lines


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


def _write(picture: Any, text: str, at: tuple[int, ...]) -> None:
    for colour, width in ((_BLACK, 3), (_WHITE, 1)):
        cv2.putText(picture, text, (at[0], at[1]), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, width, cv2.LINE_AA)
