"""Stereo odometry on rendered walls: accuracy, the way back, what moves with the camera, and honest
losses.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.vision_pc.rendering import Marker, facing, finish, render, wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.odometry.keyframes.triangulation import triangulated
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, OdometryPose, StereoPair

WALL_TILT = np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(np.radians([8.0, -10.0, 3.0]))
DISPARITY_PX, PENUMBRA_PX = 42.0, 20.0  # of the wall; of a shadow on it
LEGS = np.array([[0.5, 0.0, 0.0], [0.25, 0.25, 0.0], [0.1, -0.1, 0.2]])


@pytest.fixture(scope="module")
def texture() -> Array:
    return wall_texture(1, 22.0)


def poses(count: int) -> Iterator[Array]:
    """X_C0C along an asymmetric path of 1.1 m, at rest at its corners, turning by a few degrees."""
    corners = np.vstack([np.zeros(3), np.cumsum(LEGS, axis=0)])
    for u in np.linspace(0.0, len(LEGS), count):
        leg = min(int(u), len(LEGS) - 1)
        f = u - leg
        p = corners[leg] + LEGS[leg] * (10 * f**3 - 15 * f**4 + 6 * f**5)
        yield se3.transform(se3.exp_so3(np.radians([2 * np.sin(u), -3 * np.sin(0.7 * u), 2 * u])), p)


def pair_at(
    camera: CameraCalibration,
    texture: Array,
    X_C0C: Array,
    *,
    z: float = 1.5,
    noise: float = 2.0,
    seed: int = 0,
    markers: tuple[Marker, ...] = (),
) -> StereoPair:
    """What the camera at ``X_C0C`` sees of a wall ``z`` before C0."""
    X_C0W = se3.transform(WALL_TILT, (0.2, 0.1, z))
    wall = (texture, 0.0012 * z / 1.5, se3.inverse(X_C0C) @ X_C0W)
    return render(
        camera, markers, np.random.default_rng((7, seed)), noise=noise, wall=wall, frame_id=seed, samples=4
    )


def errors_mm(found: list[OdometryPose], true: list[Array]) -> Array:
    return 1e3 * np.array(
        [np.linalg.norm(se3.local(X, pose.X_C0C)[:3]) for pose, X in zip(found, true, strict=True)]
    )


@pytest.mark.parametrize(("z", "contrast", "limit_mm"), [(1.5, 1.0, 0.15), (3.0, 1.0, 0.3), (3.0, 0.2, 1.0)])
def test_path_is_followed(
    camera: CameraCalibration,
    config: VisionConfig,
    texture: Array,
    z: float,
    contrast: float,
    limit_mm: float,
) -> None:
    odometry = StereoOdometry(camera, config.odometry)
    pale = 118.0 + contrast * (texture - 118.0)
    found, true = [], list(poses(14))
    for k, X in enumerate(true):
        pose = odometry.process(pair_at(camera, pale, X, z=z, seed=k))
        assert pose is not None
        found.append(pose)
    np.testing.assert_array_equal(found[0].X_C0C, np.eye(4))
    assert errors_mm(found, true).max() < limit_mm
    last = se3.angle_between(found[-1].X_C0C[:3, :3], true[-1][:3, :3])
    assert np.degrees(last) < 0.02 if contrast == 1.0 else 0.05
    assert all(pose.coverage > 0.3 for pose in found)
    assert odometry.last_loss is None


def test_offset_of_the_right_eye_bends_the_path_unless_it_is_put_in(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    truly = intrinsics.with_offset(camera, -0.3, 0.2)
    true = [se3.transform(np.eye(3), (0.1 * k, 0.02 * k, 0.0)) for k in range(5)]
    pairs = [pair_at(truly, texture, X, seed=k) for k, X in enumerate(true)]
    ends = {}
    for name, believed in (("ignorant", camera), ("told", truly)):
        odometry = StereoOdometry(believed, config.odometry)
        found = [odometry.process(pair) for pair in pairs]
        assert found[-1] is not None
        ends[name] = float(np.linalg.norm(found[-1].X_C0C[:3, 3] - true[-1][:3, 3]))
    assert ends["told"] < 0.1e-3
    assert ends["ignorant"] > 1.5e-3


def test_covariance_grows_with_noise_and_covers_the_error(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    stds = []
    for noise in (2.0, 8.0):
        odometry = StereoOdometry(camera, config.odometry)
        true = list(poses(14))[:6]
        found = [
            odometry.process(pair_at(camera, texture, X, noise=noise, seed=k)) for k, X in enumerate(true)
        ]
        last = found[-1]
        assert last is not None
        assert np.linalg.eigvalsh(last.covariance).min() > 0.0
        stds.append(np.sqrt(np.diag(last.covariance)[:3]))
        assert (np.abs(last.X_C0C[:3, 3] - true[-1][:3, 3]) < 4.0 * stds[-1]).all()
    assert (stds[1] >= stds[0]).all()


def test_the_way_back_ends_where_it_began(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    """Far enough for a second keyframe; on the way back the first one holds again, so nothing adds up."""
    odometry = StereoOdometry(camera, config.odometry)
    out = [se3.transform(np.eye(3), (0.15 * k, 0.0, 0.0)) for k in range(9)]
    last = None
    for k, X in enumerate(out + out[::-1]):
        last = odometry.process(pair_at(camera, texture, X, seed=k))
        assert last is not None
    assert odometry.keyframes == 2
    assert last is not None
    assert np.linalg.norm(last.X_C0C[:3, 3]) < 0.05e-3


def test_what_the_camera_carries_is_no_part_of_the_world(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    """Half the picture is a marker that moves with the camera: told so, the odometry does not follow it."""
    tool = config.markers.tool.model_copy(update={"size_m": 0.3, "carried_m": ((-0.25, -0.25, 0.25, 0.25),)})
    X_CM = facing(0.1, 0.0, 0.45)
    carried = (Marker(5, 0.3, X_CM, rim=0.3),)
    true = [se3.transform(np.eye(3), (0.03 * k, 0.0, 0.0)) for k in range(4)]
    pairs = [pair_at(camera, texture, X, seed=k, markers=carried) for k, X in enumerate(true)]
    told = StereoOdometry(camera, config.odometry, tool)
    found = [told.process(pair, X_CM) for pair in pairs]
    assert found[-1] is not None
    assert np.linalg.norm(found[-1].X_C0C[:3, 3] - true[-1][:3, 3]) < 0.2e-3


def test_black_picture_is_lost_and_the_next_one_is_found(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    odometry = StereoOdometry(camera, config.odometry)
    true = [se3.transform(np.eye(3), (0.05 * k, 0.0, 0.0)) for k in range(4)]
    pairs = [pair_at(camera, texture, X, seed=k) for k, X in enumerate(true)]
    black = np.zeros_like(pairs[0].left)
    assert odometry.process(pairs[0]) is not None
    assert odometry.process(pairs[1]._replace(left=black, right=black)) is None
    assert odometry.last_loss == "too_dark"
    assert odometry.process(pairs[2]._replace(left=pairs[2].right[::-1].copy())) is None
    assert odometry.last_loss == "too_few_points"
    found = odometry.process(pairs[3])
    assert found is not None
    assert np.linalg.norm(found.X_C0C[:3, 3] - true[3][:3, 3]) < 0.1e-3


def test_light_that_comes_at_once_loses_nothing(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    """A shade leaves a faint wall within one frame: flow followed grey levels, and was lost for as long as no
    keyframe had the light of now.
    """
    odometry = StereoOdometry(camera, config.odometry)
    true = [se3.transform(np.eye(3), (0.04 * k, 0.01 * k, 0.0)) for k in range(12)]
    for k, X in enumerate(true):
        pair, light = pair_at(camera, texture, X, seed=k), 0.6 if k < 4 else 1.0
        left, right = (
            np.rint(light * (118.0 + 0.4 * (image - 118.0))).astype(np.uint8)
            for image in (pair.left, pair.right)
        )
        found = odometry.process(pair._replace(left=left, right=right))
        assert found is not None, f"picture {k}"
        assert np.linalg.norm(se3.local(X, found.X_C0C)[:3]) < 0.3e-3


def shaded(pair: StereoPair, edge: float) -> StereoPair:
    """``pair`` where the wall is in the shade right of ``edge``, a share of the left picture's columns."""
    columns = np.arange(pair.left.shape[1])
    pictures = []
    for picture, disparity_px in ((pair.left, 0.0), (pair.right, DISPARITY_PX)):
        beyond = np.clip((columns + disparity_px - edge * len(columns)) / PENUMBRA_PX, 0.0, 1.0)
        pictures.append(np.rint(picture * (1.0 - 0.64 * beyond)).astype(np.uint8))
    return pair._replace(left=pictures[0], right=pictures[1])


@pytest.mark.slow("pictures in a shade that moves")
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


def test_camera_that_jumped_while_blind_is_relocalised(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    odometry = StereoOdometry(camera, config.odometry)
    assert odometry.process(pair_at(camera, texture, np.eye(4))) is not None
    jumped = se3.transform(se3.exp_so3(np.radians([2.1, 2.8, 17.5])), (0.315, -0.14, 0.105))
    found = odometry.process(pair_at(camera, texture, jumped, seed=1))
    assert found is not None
    error = se3.local(jumped, found.X_C0C)
    assert np.linalg.norm(error[:3]) < 1.0e-3
    assert np.degrees(np.linalg.norm(error[3:])) < 0.05
    assert odometry.keyframes == 2  # few points are left: without a keyframe here the next picture is lost
    further = jumped @ se3.transform(np.eye(3), (0.06, 0.0, 0.0))
    found = odometry.process(pair_at(camera, texture, further, seed=2))
    assert found is not None
    assert np.linalg.norm(se3.local(further, found.X_C0C)[:3]) < 2.0e-3


@pytest.mark.parametrize(
    ("grey", "noise", "cause"),
    [
        (118.0, 2.0, "no_texture"),
        (118.0, 6.0, "no_texture"),
        (118.0, 0.0, "no_texture"),
        (2.0, 1.0, "too_dark"),
    ],
)
def test_wall_without_texture_or_light_is_refused(
    camera: CameraCalibration, config: VisionConfig, grey: float, noise: float, cause: str
) -> None:
    generator = np.random.default_rng(3)
    odometry = StereoOdometry(camera, config.odometry)
    for _ in range(2):
        left, right = (finish(np.full((720, 1280), grey), generator, noise, 0.0) for _ in range(2))
        assert odometry.process(StereoPair(left, right, 0, 0)) is None
        assert odometry.last_loss == cause
    assert odometry.keyframes == 0


def test_triangulation_inverts_projection_for_any_pair_of_eyes(camera: CameraCalibration) -> None:
    turned = camera._replace(
        right=camera.right._replace(
            X_CE=se3.transform(se3.exp_so3([0.01, -0.03, 0.02]), (0.12, 0.005, -0.01))
        )
    )
    points = np.random.default_rng(1).uniform([-1, -0.5, 0.5], [1, 0.5, 4], (40, 3))
    rays = [
        intrinsics.normalised(eye, intrinsics.project(eye, points)) for eye in (turned.left, turned.right)
    ]
    found, good = triangulated(rays[0], rays[1], turned, 3.0)
    assert good.all()
    np.testing.assert_allclose(found, points, atol=1e-7)
    _, backwards = triangulated(rays[0] - [0.5, 0.0], rays[1], turned, 3.0)
    assert not backwards.any()
