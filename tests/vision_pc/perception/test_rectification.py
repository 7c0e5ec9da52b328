"""Raw pairs become pairs whose rows belong together, as OpenCV has it and as exact projection says."""

import numpy as np
import pytest

from protocol.errors import ConfigurationError, FrameRefused
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import COEFFICIENTS, RawEye, StereoCalibration
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.rectification import (
    Rectifier,
    geometry,
    raw_lens,
    rectified_camera,
    right_eye,
)
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image, StereoPair

BENT = {
    LensModel.BROWN_CONRADY: ((-0.17, 0.025, 0.0003, -0.0002, 0.001), (-0.16, 0.021, -0.0001, 0.0004, 0.0)),
    LensModel.RATIONAL: (
        (0.1, 0.02, 0.0003, -0.0002, 0.005, 0.2, 0.06, 0.01),
        (0.11, 0.02, -0.0001, 0.0004, 0.005, 0.21, 0.06, 0.01),
    ),
    LensModel.FISHEYE: ((0.02, -0.01, 0.003, -0.0005), (0.021, -0.011, 0.002, -0.0004)),
}


def raw_camera(
    lens: LensModel, size: tuple[int, int] = (640, 360), focal: float = 350.0
) -> StereoCalibration:
    """Two eyes that differ, the right one turned by half a degree and not quite beside the left."""
    width, height = size
    eyes = [
        RawEye(lens=lens, fx_px=focal + k, fy_px=focal - k, cx_px=width / 2 + 3 * k, cy_px=height / 2 - 2 * k,
               distortion=BENT[lens][k])
        for k in (0, 1)
    ]  # fmt: skip
    return StereoCalibration(
        format="longreach-camera/1",
        width_px=width,
        height_px=height,
        left=eyes[0],
        right=eyes[1],
        right_position_m=(0.12, 0.0004, -0.0007),
        right_rotation_vector_deg=(0.3, -0.5, 0.2),
    )


def seen_raw(calibration: StereoCalibration, points: Array) -> list[Array]:
    """Raw pixels of points (n, 3) in the raw left eye's axes."""
    in_right = se3.apply(se3.inverse(right_eye(calibration)), points)
    return [raw_lens(calibration.left).project(points), raw_lens(calibration.right).project(in_right)]


@pytest.mark.parametrize("lens", list(LensModel))
def test_points_fall_into_one_row_and_where_the_rectified_camera_sees_them(lens: LensModel) -> None:
    calibration = raw_camera(lens)
    points = np.random.default_rng(1).uniform([-1.0, -0.5, 1.5], [1.0, 0.5, 3.0], (200, 3))
    found, camera = geometry(calibration), rectified_camera(calibration)
    rectified = []
    for raw, eye, R in zip(
        seen_raw(calibration, points), (found.left, found.right), (found.R_left, found.R_right), strict=True
    ):
        rays = np.column_stack([eye.undistorted(raw), np.ones(len(raw))]) @ R.T
        rectified.append(rays[:, :2] / rays[:, 2:] * found.K[[0, 1], [0, 1]] + found.K[:2, 2])
    np.testing.assert_allclose(rectified[0][:, 1], rectified[1][:, 1], atol=1e-6)
    in_C = points @ found.R_left.T
    for seen, model in zip(rectified, (camera.left, camera.right), strict=True):
        np.testing.assert_allclose(seen, intrinsics.project(model, in_C), atol=1e-6)


@pytest.mark.parametrize("lens", list(LensModel))
def test_every_pixel_of_the_result_comes_from_within_the_picture(lens: LensModel) -> None:
    white: Image = np.full((360, 640), 200, dtype=np.uint8)
    found = Rectifier(raw_camera(lens))(StereoPair(white, white, 0, 0))
    for picture in (found.left, found.right):
        assert (picture[1:-1, 1:-1] == 200).mean() > 0.999


def test_a_picture_of_another_size_says_which_came_and_which_was_wanted() -> None:
    small: Image = np.zeros((100, 200), dtype=np.uint8)
    with pytest.raises(FrameRefused, match="200x100 px an eye came, 640x360 are wanted") as refusal:
        Rectifier(raw_camera(LensModel.RATIONAL))(StereoPair(small, small, 0, 0))
    assert refusal.value.cause == "frame.wrong_size"


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_lens_that_folds_over_is_refused(side: str) -> None:
    calibration = raw_camera(LensModel.BROWN_CONRADY)
    eye: RawEye = getattr(calibration, side)
    folded = eye.model_copy(update={"distortion": (-0.9, 0.0, 0.0, 0.0, 0.0)})
    with pytest.raises(
        ConfigurationError, match=rf"{side}\.distortion = .* folds over .*another lens"
    ) as refused:
        Rectifier(calibration.model_copy(update={side: folded}))
    assert refused.value.cause == "configuration.lens_folds"


def test_each_lens_has_its_coefficients_named() -> None:
    for lens, names in COEFFICIENTS.items():
        assert len(BENT[lens][0]) == len(names)
