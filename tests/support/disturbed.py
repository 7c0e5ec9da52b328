"""Pytest plugin: ``-p tests.support.disturbed --disturb K`` repeats tests with inputs off in the ninth digit.

An outcome that turns over then was no result.

Three places see every input: pixels become rays, counts become angles, and light becomes grey levels. Each
pixel coordinate and each angle is off by up to 1e-9 of itself, and of every picture one pixel by one grey,
by an amount that the number K and the value itself choose: reruns with the same K repeat to the bit.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from controller.core import plant_watch
from plant_emulator.core.camera.exposures import Shot
from plant_emulator.core.camera.stereo_camera import StereoCamera
from tests.vision_pc import rendering
from vision_pc.core.perception import intrinsics

Grey = NDArray[np.uint8]

SIZE = 1e-9


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--disturb K``; 0 disturbs nothing."""
    parser.addoption("--disturb", type=int, default=0, help="disturb all inputs in the ninth digit")


def pytest_configure(config: pytest.Config) -> None:
    """Put the disturbance in, for the whole session."""
    number = config.getoption("--disturb")
    if number:
        disturb(number)


def disturb(number: int) -> None:
    """Disturb pixels, pictures and encoders from now on, as ``number`` (1, 2, …) chooses."""

    def off(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(values * (1.0 + SIZE * np.sin(1e6 * values + number)))

    normalised = intrinsics.normalised
    intrinsics.normalised = lambda eye, pixels: normalised(eye, off(np.asarray(pixels, np.float64)))
    plant_watch.RAD_PER_COUNT *= 1.0 + SIZE * float(np.sin(number))
    StereoCamera.take_eye = _one_grey_off(StereoCamera.take_eye, number)  # type: ignore[assignment, method-assign]
    finish = rendering.finish
    rendering.finish = lambda *args, **named: _off_by_one(finish(*args, **named), number)


def _one_grey_off(
    take_eye: Callable[[StereoCamera, int, Shot], Grey], number: int
) -> Callable[[StereoCamera, int, Shot], Grey]:
    def disturbed(camera: StereoCamera, eye: int, shot: Shot) -> Grey:
        return _off_by_one(take_eye(camera, eye, shot), number + 2 * shot.shown.frame_id + eye)

    return disturbed


def _off_by_one(picture: Grey, key: int) -> Grey:
    """``picture`` with the lowest bit of one pixel turned over, in place."""
    picture.flat[np.random.default_rng(key).integers(picture.size)] ^= 1
    return picture
