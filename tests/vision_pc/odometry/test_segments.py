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
    found = []
    for k in range(count):
        X = at(0.02 * k)
        pair = pair_at(camera, texture, X, seed=k)
        if k >= enters:
            Y = X @ se3.transform(np.eye(3), (-0.015 * (k - enters), 0.0, 0.0))
            pair = composed(pair, pair_at(camera, texture, Y, z=1.2, seed=90 + k), share)
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
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    odometry = SegmentedOdometry(camera, config.odometry_of_recordings)
    elsewhere = wall_texture(5, 22.0, 1000)
    dark = np.zeros((720, 1280), np.uint8)
    black = StereoPair(dark, dark, 0, 0)
    for k in range(6):  # at rest, until rest is foreseen
        assert odometry.process(pair_at(camera, texture, at(0.0), seed=k)) is not None
    for _ in range(4):
        assert odometry.process(black) is None
        assert odometry.last_loss == "too_dark"
    for k in range(6):
        assert odometry.process(pair_at(camera, elsewhere, at(0.0), seed=10 + k)) is not None
    assert odometry.joints[1:] == [None]
    both = None
    for k in range(2, 4):  # both walls are in the same place: now half of each is seen
        pair = pair_at(camera, texture, at(0.002 * k), seed=1 + k)
        both = odometry.process(composed(pair, pair_at(camera, elsewhere, at(0.002 * k), seed=5 + k), 0.5))
    assert both is not None
    assert both.segment == 0
    assert np.linalg.norm(se3.local(at(0.006), both.pose.X_C0C)[:3]) < 0.5e-3
    assert odometry.joints[1] is not None, "the newer map hangs on the first one: its C0 is where that began"
    assert np.linalg.norm(se3.local(se3.identity(), odometry.joints[1])[:3]) < 1.0e-3


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
