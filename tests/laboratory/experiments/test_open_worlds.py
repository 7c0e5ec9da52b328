"""Roads and rooms: pictures are true to the world, and odometry follows them or says that it is lost."""

from pathlib import Path

import numpy as np
import pytest

from foundation.configuration import load
from laboratory.experiments.odometry.open_worlds import CAR, open_sequence
from laboratory.experiments.odometry.ray_casting import CastWorld, RayCaster, Rectangle, rough_texture
from laboratory.experiments.odometry.sequences import Sequence
from laboratory.experiments.odometry.verdict import judged
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration, Image, StereoPair
from vision_pc.shell.cameras.sequence import SequenceResult, follow_pairs

CONFIGS = Path("configs")
COUNT = 16

pytestmark = pytest.mark.slow("roads are drawn and followed")


@pytest.fixture(scope="module")
def road() -> Sequence:
    return open_sequence("road", 8901, COUNT)


def known(made: Sequence) -> CameraCalibration:
    """What is told of the camera."""
    told = made.stated
    K = np.array([[told.fx_px, 0.0, told.cx_px], [0.0, told.fy_px, told.cy_px], [0.0, 0.0, 1.0]])
    config = load(VisionConfig, CONFIGS / "vision.yaml")
    given = intrinsics.calibration(config.camera)
    left, right = given.left._replace(K=K), given.right._replace(K=K)
    right = right._replace(X_CE=se3.transform(np.eye(3), (told.baseline_m, 0.0, 0.0)))
    return CameraCalibration(CAR.width, CAR.height, left, right)


def followed(made: Sequence, pairs: list[StereoPair]) -> SequenceResult:
    config, camera = load(VisionConfig, CONFIGS / "vision.yaml"), known(made)
    return follow_pairs(lambda: pairs, lambda _: SegmentedOdometry(camera, config.odometry_of_recordings))


def test_a_rectangle_is_where_the_pinhole_has_it() -> None:
    """A square of 2 m, 10 m ahead, is 2 f / 10 px wide, and its right view the disparity farther left."""
    texture = np.stack([rough_texture(np.random.default_rng(1), 5.0, 60.0)])
    square = Rectangle((-1.0, -1.0, 10.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), 0, 0.01)
    camera = known(Sequence([], np.zeros((0, 4, 4)), open_sequence("road", 8901, 1).stated))
    left, right = RayCaster(CastWorld([square], texture, 200.0)).pictures(camera, se3.identity())
    for grey, shift in ((left, 0.0), (right, CAR.f_px * CAR.baseline_m / 10.0)):
        rows, columns = np.nonzero(grey < 150.0)
        for value, expected in (
            (columns.min(), CAR.cx_px - shift - 0.1 * CAR.f_px),
            (columns.max(), CAR.cx_px - shift + 0.1 * CAR.f_px),
            (rows.min(), CAR.cy_px - 0.1 * CAR.f_px),
            (rows.max(), CAR.cy_px + 0.1 * CAR.f_px),
        ):
            assert abs(value - expected) <= 1.0


def test_on_a_road_the_disparities_offset_is_found_and_taken_out(road: Sequence) -> None:
    """The way alone tells it: without, 1 % of the way is lost."""
    result = followed(road, road.pairs)
    found = judged(result, road.X_C0C)
    assert (found.located, found.wrong) == (COUNT, 0)
    assert result.offset is not None
    assert result.offset.std_px < 0.1
    assert found.worst_m < 0.005 * float(np.linalg.norm(road.X_C0C[-1, :3, 3]))


def test_pictures_that_the_camera_exposes_otherwise_are_followed(road: Sequence) -> None:
    def lit(picture: Image, k: int) -> Image:
        return np.asarray(picture * (0.7 + 0.3 * np.sin(k / 2.0) ** 2), dtype=np.uint8)

    pairs = [
        pair._replace(left=lit(pair.left, k), right=lit(pair.right, k)) for k, pair in enumerate(road.pairs)
    ]
    assert judged(followed(road, pairs), road.X_C0C).located == COUNT


def test_a_thing_that_fills_most_of_the_picture_is_not_the_world(road: Sequence) -> None:
    """Six tenths of the width go aside by 9 px a picture, 8 m ahead: once followed for 54 m at exit 0."""
    texture = np.tile(rough_texture(np.random.default_rng(5), 35.0), (1, 8))
    near_px = round(CAR.f_px * CAR.baseline_m / 8.0)
    wide = int(0.6 * CAR.width)
    first = (CAR.width - wide) // 2
    pairs = []
    for k, pair in enumerate(road.pairs):
        left, right, at = pair.left.copy(), pair.right.copy(), 1500 - 9 * k
        thing = np.clip(texture[: CAR.height, at : at + wide], 0, 255).astype(np.uint8)
        left[:, first : first + wide] = thing
        right[:, first - near_px : first - near_px + wide] = thing
        pairs.append(pair._replace(left=left, right=right))
    found = judged(followed(road, pairs), road.X_C0C)
    assert found.wrong == 0
    assert found.located < 0.4 * COUNT
