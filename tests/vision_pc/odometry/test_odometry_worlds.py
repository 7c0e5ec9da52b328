"""Odometry where the world is no plane of rich texture: bare patches, depth steps, things that move.

What is asked is the same everywhere: right, or lost by name.
"""

import numpy as np
import pytest

from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception.intrinsics import with_offset
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoPair

TRUE = [se3.transform(np.eye(3), (0.02 * k, 0.01 * k, 0.0)) for k in range(6)]
GREY = 118.0
DISPARITY_PX = 42.0  # of the wall
PENUMBRA_PX = 20.0


@pytest.fixture(scope="module")
def texture() -> Array:
    return wall_texture(1, 22.0)


def composed(rest: StereoPair, part: StereoPair, share: float) -> StereoPair:
    """``rest`` with the left ``share`` of its columns taken from ``part``, in both eyes."""
    edge = int(share * rest.left.shape[1])
    pictures = []
    for whole, other in ((rest.left, part.left), (rest.right, part.right)):
        picture = whole.copy()
        picture[:, :edge] = other[:, :edge]
        pictures.append(picture)
    return rest._replace(left=pictures[0], right=pictures[1])


def errors_and_losses(odometry: StereoOdometry, pairs: list[StereoPair]) -> tuple[list[float], list[str]]:
    """Error (m) of each frame that was tracked, and why the others were lost."""
    errors, losses = [], []
    for pair, X in zip(pairs, TRUE, strict=True):
        found = odometry.process(pair)
        if found is None:
            losses.append(odometry.last_loss or "")
        else:
            errors.append(float(np.linalg.norm(se3.local(X, found.X_C0C)[:3])))
    return errors, losses


@pytest.mark.parametrize("bare", [0.4, 0.7])
def test_bare_patches_of_the_wall_do_no_harm(
    camera: CameraCalibration, config: VisionConfig, texture: Array, bare: float
) -> None:
    patchy = texture.copy()
    columns = np.arange(patchy.shape[1]) % 500 < 500 * bare
    patchy[:, columns] = GREY
    pairs = [pair_at(camera, patchy, X, seed=k) for k, X in enumerate(TRUE)]
    errors, losses = errors_and_losses(StereoOdometry(camera, config.odometry), pairs)
    assert max(errors) < 0.4e-3
    assert not losses


def shaded(pair: StereoPair, edge: float) -> StereoPair:
    """``pair`` where the wall is in the shade right of ``edge``, a share of the left picture's columns."""
    columns = np.arange(pair.left.shape[1])
    pictures = []
    for picture, disparity_px in ((pair.left, 0.0), (pair.right, DISPARITY_PX)):
        beyond = np.clip((columns + disparity_px - edge * len(columns)) / PENUMBRA_PX, 0.0, 1.0)
        pictures.append(np.rint(picture * (1.0 - 0.64 * beyond)).astype(np.uint8))
    return pair._replace(left=pictures[0], right=pictures[1])


def test_a_shadow_that_comes_and_goes_leaves_no_trace(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    """An arm at rest before a wall over which a shadow sweeps: each time a keyframe was made where few points
    held it, and the path walked off by a millimetre and more in a minute.
    """
    odometry = StereoOdometry(camera, config.odometry)
    rest = pair_at(camera, texture, np.eye(4))
    errors = []
    for k, edge in enumerate(3 * [1.0, 0.8, 0.6, 0.4, 0.2, 0.0, 0.3, 0.7]):
        found = odometry.process(shaded(rest, edge))
        assert found is not None, f"picture {k}: {odometry.last_loss}"
        errors.append(float(np.linalg.norm(found.X_C0C[:3, 3])))
    assert max(errors) < 0.2e-3
    assert odometry.keyframes == 1


@pytest.mark.slow("a hundred pictures at rest")
def test_a_camera_that_warms_at_rest_does_not_stretch_the_way(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    """The right eye's columns walk by 0.3 px of 42 while the arm rests after 0.3 m: 2 mm, were all pictures
    to teach the map's scale.
    """
    way = [se3.transform(np.eye(3), (0.03 * k, 0.0, 0.0)) for k in range(11)]
    odometry = StereoOdometry(camera, config.odometry)
    for k, X in enumerate(way):
        arrived = odometry.process(pair_at(camera, texture, X, seed=k))
    last = arrived
    for k in range(100):
        warmer = with_offset(camera, 0.003 * k, 0.0)
        last = odometry.process(pair_at(warmer, texture, way[-1], seed=100 + k))
    assert arrived is not None
    assert last is not None
    assert abs(last.X_C0C[0, 3] - arrived.X_C0C[0, 3]) < 0.3e-3


def test_a_depth_step_does_no_harm(camera: CameraCalibration, config: VisionConfig, texture: Array) -> None:
    pairs = [
        composed(
            pair_at(camera, texture, X, seed=k), pair_at(camera, texture, X, z=2.2, seed=50 + k), share=0.5
        )
        for k, X in enumerate(TRUE)
    ]
    errors, losses = errors_and_losses(StereoOdometry(camera, config.odometry), pairs)
    assert max(errors) < 0.4e-3
    assert not losses


def moving(camera: CameraCalibration, texture: Array, share: float) -> list[StereoPair]:
    """Something textured, ``share`` of the picture wide, goes its own way by 15 mm a frame."""
    astray = [X @ se3.transform(np.eye(3), (-0.015 * k, 0.0, 0.0)) for k, X in enumerate(TRUE)]
    return [
        composed(
            pair_at(camera, texture, X, seed=k), pair_at(camera, texture, Y, z=1.2, seed=90 + k), share=share
        )
        for k, (X, Y) in enumerate(zip(TRUE, astray, strict=True))
    ]


def test_a_small_thing_that_moves_is_outvoted(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    """Where the arm tells how the camera went; without it nothing tells before some pairs were located."""
    pairs, odometry = moving(camera, texture, 0.2), StereoOdometry(camera, config.odometry)
    found = [odometry.process(pair, X_BT=X) for pair, X in zip(pairs, TRUE, strict=True)]
    assert all(pose is not None for pose in found)
    errors = [np.linalg.norm(se3.local(X, f.X_C0C)[:3]) for X, f in zip(TRUE, found, strict=True) if f]
    assert max(errors) < 0.5e-3
    alone, losses = errors_and_losses(StereoOdometry(camera, config.odometry), pairs)
    assert max(alone) < 0.5e-3
    assert set(losses) <= {"sudden_motion", "two_motions"}


@pytest.mark.parametrize("share", [0.45, 0.6])
def test_a_large_thing_that_moves_is_named_and_not_followed(
    camera: CameraCalibration, config: VisionConfig, texture: Array, share: float
) -> None:
    pairs = moving(camera, texture, share)
    errors, losses = errors_and_losses(StereoOdometry(camera, config.odometry), pairs)
    assert max(errors) < 1.0e-3
    assert "two_motions" in losses
