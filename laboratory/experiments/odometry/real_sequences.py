"""Real pictures for the matrix: a stereo camera at rest before a person who turns a board about.

OpenCV's 13 pairs of a checkerboard, read where the hand-eye experiment has them. The camera does not move, so
the truth is known: what moves covers a third of every picture, and from pair to pair it is elsewhere. Its
calibration is found from the same boards, as `longreach camera calibrate` does.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from laboratory.experiments.hand_eye.real_sets import OPENCV_BOARD, checkerboard_pictures
from laboratory.experiments.odometry.sequences import RATE_HZ, Sequence
from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.config.choices import Detector, LensModel
from vision_pc.config.vision import RectifiedPairSettings
from vision_pc.core import se3
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.rectification import Rectifier, rectified_camera
from vision_pc.core.types import Image, StereoPair

_DIM, _NOISE_GREY = 0.06, 1.5
_BLACK = 5
_LOWER_PX = 3

Pictures = list[tuple[Image, Image]]


class RealKind(NamedTuple):
    """What it is in ``words``, and what is made of the pictures; ``refused``: nothing else is right."""

    words: str
    made: Callable[[Pictures], Pictures]
    refused: bool = False


def _dark(pictures: Pictures) -> Pictures:
    rng = np.random.default_rng(14)

    def dim(picture: Image) -> Image:
        noisy = _DIM * picture + rng.normal(0.0, _NOISE_GREY, picture.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    return [(dim(left), dim(right)) for left, right in pictures]


def _black(pictures: Pictures) -> Pictures:
    first = len(pictures) // 2
    nothing = (np.zeros_like(pictures[0][0]), np.zeros_like(pictures[0][1]))
    return [*pictures[:first], *[nothing] * _BLACK, *pictures[first:]]


def _lower(pictures: Pictures) -> Pictures:
    return [(left, np.roll(right, _LOWER_PX, axis=0)) for left, right in pictures]


REAL_KINDS: dict[str, RealKind] = {
    "real_rest": RealKind("real: camera at rest, person and board move", lambda pictures: pictures),
    "real_twice": RealKind("real: there and back", lambda pictures: [*pictures, *pictures[-2::-1]]),
    "real_half": RealKind("real: every second pair", lambda pictures: pictures[::2]),
    "real_dark": RealKind("real: 6 % of the light", _dark),
    "real_black": RealKind("real: 5 black pairs", _black),
    "real_rows_3": RealKind("real: right picture 3 px lower", _lower, refused=True),
    "real_swapped": RealKind("real: eyes swapped", lambda p: [(r, l) for l, r in p], refused=True),  # noqa: E741
}


def available() -> bool:
    """Whether the pictures are there."""
    try:
        return bool(checkerboard_pictures())
    except RequestRefused:
        return False


def real_sequence(name: str) -> Sequence:
    """The rectified pairs of kind ``name``. Raises RequestRefused where the pictures are not."""
    pictures, stated = _rectified_pairs()
    made = REAL_KINDS[name].made(list(pictures))
    pairs = [StereoPair(left, right, round(k * 1e9 / RATE_HZ), k) for k, (left, right) in enumerate(made)]
    return Sequence(pairs, np.tile(se3.identity(), (len(pairs), 1, 1)), stated)


@lru_cache(maxsize=1)
def _rectified_pairs() -> tuple[tuple[tuple[Image, Image], ...], RectifiedPairSettings]:
    raw = [
        StereoPair(left, right, 0, k)
        for k, ((_, left), (_, right)) in enumerate(
            zip(checkerboard_pictures("left"), checkerboard_pictures("right"), strict=True)
        )
    ]
    height, width = raw[0].left.shape
    views = []
    for pair in raw:
        try:
            left, right = (
                zhang.find_checkerboard(picture, OPENCV_BOARD, Detector.SECTORS, str(pair.frame_id))
                for picture in (pair.left, pair.right)
            )
            views.append(stereo_fit.paired(left, right))
        except MeasurementFailed:
            continue
    found = stereo_fit.fit(views, (width, height), LensModel.BROWN_CONRADY, "OpenCV's pairs").calibration
    rectify, camera = Rectifier(found), rectified_camera(found)
    K = camera.left.K
    stated = RectifiedPairSettings(
        fx_px=float(K[0, 0]), fy_px=float(K[1, 1]), cx_px=float(K[0, 2]), cy_px=float(K[1, 2]),
        baseline_m=float(camera.right.X_CE[0, 3]), width_px=width, height_px=height,
    )  # fmt: skip
    done = [rectify(pair) for pair in raw]
    return tuple((pair.left.copy(), pair.right.copy()) for pair in done), stated
