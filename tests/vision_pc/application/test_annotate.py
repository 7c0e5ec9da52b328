"""The annotated picture: outlines where the corners are, frames where the poses are, words for the rest."""

import numpy as np

from vision_pc.application.annotate import annotated, in_words
from vision_pc.core.se3 import transform
from vision_pc.core.types import CameraCalibration, FrameObservation, MarkerObservation, StereoPair

CORNERS = np.array([[600.0, 300.0], [700.0, 300.0], [700.0, 400.0], [600.0, 400.0]])


def observation(seen: bool) -> FrameObservation:
    X = transform(np.diag([1.0, -1.0, -1.0]), [0.02, -0.03, 0.6])
    marker = MarkerObservation(3, 0.12, CORNERS, None, X, np.eye(6), 0.1, 100.0)
    X_CO = X @ transform(np.eye(3), [0.01, 0.0, 0.0])
    cov = 1e-6 * np.eye(6)
    if not seen:
        return FrameObservation(0, 7, X, cov, cov, None, None, None, (), {}, None)
    return FrameObservation(0, 7, X, cov, cov, X_CO, cov, cov, (marker,), {}, None)


def pair() -> StereoPair:
    grey = np.full((720, 1280), 90, np.uint8)
    return StereoPair(grey, grey, 0, 7)


def test_outline_axes_and_caption_are_drawn_and_nothing_else(camera: CameraCalibration) -> None:
    picture = annotated(pair(), observation(True), camera, 0.1)
    assert picture.shape == (720, 1280, 3)
    changed = np.any(picture != 90, axis=2)
    for x, y in CORNERS.astype(int):
        assert changed[y - 2 : y + 3, x - 2 : x + 3].any()
    assert picture[300, 650].argmax() == 1  # green outline
    centre = (530.0 * np.array([0.02, -0.03]) / 0.6 + [639.5, 359.5]).astype(int)
    assert changed[centre[1] - 3 : centre[1] + 4, centre[0] - 3 : centre[0] + 4].any()
    assert not changed[450:, :].any()


def test_what_was_not_seen_is_said_and_no_error_is_made_up() -> None:
    lines = in_words(observation(False), 0.1)
    assert "object: not seen" in lines
    assert not any(line.startswith("error") for line in lines)
    shown = in_words(observation(True), 0.1)
    assert shown[-1] == "error: x +10.0  y +0.0  z -100.0 mm"
