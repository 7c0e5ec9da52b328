"""The annotated picture: outlines where the corners are, frames where the poses are."""

import numpy as np

from vision_pc.application.annotate import annotated
from vision_pc.core.se3 import transform
from vision_pc.core.types import CameraCalibration, FrameObservation, MarkerObservation, StereoPair

CORNERS = np.array([[600.0, 300.0], [700.0, 300.0], [700.0, 400.0], [600.0, 400.0]])


def observation() -> FrameObservation:
    X = transform(np.diag([1.0, -1.0, -1.0]), [0.02, -0.03, 0.6])
    marker = MarkerObservation(3, 0.12, CORNERS, None, X, np.eye(6), 0.1, 100.0)
    X_CO = X @ transform(np.eye(3), [0.01, 0.0, 0.0])
    cov = 1e-6 * np.eye(6)
    return FrameObservation(0, 7, X, cov, cov, X_CO, cov, cov, (marker,), {}, None)


def pair() -> StereoPair:
    grey = np.full((720, 1280), 90, np.uint8)
    return StereoPair(grey, grey, 0, 7)


def test_outline_and_axes_are_drawn_and_nothing_else(camera: CameraCalibration) -> None:
    picture = annotated(pair(), observation(), camera)
    assert picture.shape == (720, 1280, 3)
    changed = np.any(picture != 90, axis=2)
    for x, y in CORNERS.astype(int):
        assert changed[y - 2 : y + 3, x - 2 : x + 3].any()
    assert picture[300, 650].argmax() == 1  # green outline
    centre = (530.0 * np.array([0.02, -0.03]) / 0.6 + [639.5, 359.5]).astype(int)
    assert changed[centre[1] - 3 : centre[1] + 4, centre[0] - 3 : centre[0] + 4].any()
    assert not changed[450:, :].any()
