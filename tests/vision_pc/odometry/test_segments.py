"""Odometry of recordings: what moves is told by the motion before, gaps begin maps, bad pairs are named."""

import numpy as np
import pytest

from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoPair


@pytest.fixture(scope="module")
def texture() -> Array:
    return wall_texture(1, 22.0)


def at(x: float) -> Array:
    return se3.transform(np.eye(3), (x, 0.3 * x, 0.0))


def composed(rest: StereoPair, part: StereoPair, share: float) -> StereoPair:
    """``rest`` with the left ``share`` of its columns taken from ``part``, in both eyes."""
    edge = int(share * rest.left.shape[1])
    pictures = []
    for whole, other in ((rest.left, part.left), (rest.right, part.right)):
        picture = whole.copy()
        picture[:, :edge] = other[:, :edge]
        pictures.append(picture)
    return rest._replace(left=pictures[0], right=pictures[1])


def with_mover(
    camera: CameraCalibration, texture: Array, share: float, count: int, enters: int
) -> list[tuple[Array, StereoPair]]:
    """From frame ``enters`` on something textured hides a ``share`` of the picture and goes its own way."""
    found, other = [], wall_texture(5, 22.0, 3200)
    for k in range(count):
        X = at(0.02 * k)
        pair = pair_at(camera, texture, X, seed=k)
        if k >= enters:
            Y = X @ se3.transform(np.eye(3), (-0.015 * (k - enters), 0.0, 0.0))
            pair = composed(pair, pair_at(camera, other, Y, z=1.2, seed=90 + k), share)
        found.append((X, pair))
    return found


@pytest.mark.parametrize(("share", "located"), [(0.3, 8), (0.6, 5)])
def test_what_the_motion_before_foresaw_is_believed(
    camera: CameraCalibration, config: VisionConfig, texture: Array, share: float, located: int
) -> None:
    odometry = SegmentedOdometry(camera, config.odometry_of_recordings)
    right = 0
    for X, pair in with_mover(camera, texture, share, 8, 5):
        placed = odometry.process(pair)
        if placed is None:
            assert odometry.last_loss in ("two_motions", "sudden_motion")
        elif odometry.joints[placed.segment] is not None:
            assert np.linalg.norm(se3.local(X, placed.pose.X_C0C)[:3]) < 0.5e-3
            right += 1
    assert right >= located


@pytest.mark.slow("rendered pictures before and after a gap")
def test_after_a_gap_a_new_map_begins_and_is_joined_when_the_old_is_seen_again(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    odometry, wide = SegmentedOdometry(camera, config.odometry_of_recordings), wall_texture(1, 22.0, 6000)
    dark = np.zeros((720, 1280), np.uint8)
    black = StereoPair(dark, dark, 0, 0)
    for k, x in enumerate((-1.60, -1.58)):
        assert odometry.process(pair_at(camera, wide, at(x), seed=k)) is not None
    for _ in range(4):
        assert odometry.process(black) is None
        assert odometry.last_loss == "too_dark"
    back = [odometry.process(pair_at(camera, wide, at(1.4 - 0.2 * k), seed=10 + k)) for k in range(12)]
    assert odometry.joints[1:] != [], "what is seen after the gap is nowhere in the first map"
    assert back[-1] is not None
    joint = odometry.joints[back[-1].segment]
    assert joint is not None
    first = se3.inverse(at(-1.60)) @ at(1.4 - 0.2 * 11)
    assert np.linalg.norm(se3.local(first, joint @ back[-1].pose.X_C0C)[:3]) < 2e-3
    assert odometry.joints[1] is not None, "the newer map hangs on the first one"


@pytest.mark.parametrize(
    ("spoil", "cause", "figure"),
    [
        (
            lambda pair: pair._replace(right=np.roll(pair.right, 3, axis=0)),
            "bad_rectification",
            "rows +3.0 px",
        ),
        (lambda pair: pair._replace(left=pair.right, right=pair.left), "swapped_eyes", "farther right"),
    ],
)
def test_a_pair_that_cannot_be_used_is_named_with_its_figure(
    camera: CameraCalibration, config: VisionConfig, texture: Array, spoil: object, cause: str, figure: str
) -> None:
    odometry = StereoOdometry(camera, config.odometry)
    assert callable(spoil)
    assert odometry.process(spoil(pair_at(camera, texture, at(0.0)))) is None
    assert odometry.last_loss == cause
    assert odometry.last_detail is not None
    assert figure in odometry.last_detail
