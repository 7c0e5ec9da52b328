"""What rectifying a raw pair costs, beside OpenCV's own way."""

import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from tests.vision_pc.perception.test_rectification import raw_camera
from vision_pc.config.choices import LensModel
from vision_pc.core.perception.rectification import Rectifier, geometry
from vision_pc.core.types import StereoPair

pytestmark = [pytest.mark.usefixtures("one_core"), pytest.mark.bench, pytest.mark.timeout(600)]


def least_ms(work: Callable[[], object]) -> float:
    """Processor time of one thread, the least of 100 rounds."""
    spent = []
    for _ in range(100):
        begin = time.thread_time()
        work()
        spent.append(time.thread_time() - begin)
    return 1e3 * min(spent)


def test_a_720p_pair_is_rectified_sooner_than_by_float_maps() -> None:
    calibration = raw_camera(LensModel.BROWN_CONRADY, (1280, 720), 700.0)
    grey = np.random.default_rng(1).integers(0, 255, (2, 720, 1280), dtype=np.uint8)
    pictures = [np.asarray(cv2.GaussianBlur(one, (9, 9), 2.0), dtype=np.uint8) for one in grey]
    pair = StereoPair(pictures[0], pictures[1], 0, 0)
    rectify, found = Rectifier(calibration), geometry(calibration)
    floats = [
        cv2.initUndistortRectifyMap(eye.K, eye.distortion, R, found.K, (1280, 720), cv2.CV_32FC1)
        for eye, R in ((found.left, found.R_left), (found.right, found.R_right))
    ]

    def theirs() -> None:
        for picture, maps in zip(pictures, floats, strict=True):
            cv2.remap(picture, *maps, cv2.INTER_LINEAR)

    ours, peer = least_ms(lambda: rectify(pair)), least_ms(theirs)
    print(f"\nrectified 720p pair: {ours:.2f} ms; cv2.remap with float maps {peer:.2f} ms")
    assert ours < peer
