"""The arm's own state tells the camera's motion from that of what moves before it."""

import numpy as np
import pytest

from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.odometry.arm_prior import ArmHistory, ArmPrior
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

X_CT = se3.transform(se3.exp_so3([0.4, -1.1, 2.0]), (0.2, -0.3, 0.1))  # nobody knows it
X_BC0 = se3.transform(se3.exp_so3([1.0, 0.2, -0.7]), (3.0, -1.0, 0.5))


def told(X_C0C: Array) -> Array:
    """X_BT of an arm whose model is right."""
    return X_BC0 @ X_C0C @ X_CT


def prior_at(config: VisionConfig, X_C0C: Array) -> ArmPrior:
    history = ArmHistory(config.odometry.lever_m)
    history.found(se3.identity(), told(se3.identity()))
    prior = history.prior(told(X_C0C))
    assert prior is not None
    return prior


def test_wherever_the_camera_sits_the_arm_foresees_how_far_it_goes(
    config: VisionConfig, generator: np.random.Generator
) -> None:
    for _ in range(20):
        X = se3.transform(se3.exp_so3(generator.normal(0.0, 0.05, 3)), generator.normal(0.0, 0.2, 3))
        prior = prior_at(config, X)
        assert prior.agrees(X)
        farther = X.copy()
        farther[:3, 3] *= 1.0 + 0.4 / np.linalg.norm(X[:3, 3])
        assert not prior.agrees(farther)
        turned = X.copy()
        turn = se3.log_so3(X[:3, :3])
        turned[:3, :3] = se3.exp_so3(turn * (1.0 + 0.02 / np.linalg.norm(turn)))
        assert not prior.agrees(turned)


def test_tolerances_are_of_the_configured_size(config: VisionConfig) -> None:
    limit = 3.0 * 0.004  # m
    for share, agrees in ((0.95, True), (1.05, False)):
        X = se3.transform(np.eye(3), (share * limit, 0.0, 0.0))
        assert prior_at(config, se3.identity()).agrees(X) is agrees
    X = se3.transform(np.eye(3), (3.0 * limit, 0.0, 0.0))
    assert prior_at(config, se3.identity()).agrees(X, tolerance=4.0)


def test_without_a_state_nothing_is_foreseen(config: VisionConfig) -> None:
    history = ArmHistory(config.odometry.lever_m)
    history.found(se3.identity(), None)
    assert history.prior(se3.identity()) is None
    history.found(se3.identity(), se3.identity())
    assert history.prior(None) is None
    assert history.prior(se3.identity()) is not None


@pytest.fixture(scope="module")
def texture() -> Array:
    return wall_texture(1, 22.0)


def test_one_motion_that_the_arm_did_not_make_is_not_believed(
    camera: CameraCalibration, config: VisionConfig, texture: Array
) -> None:
    """All that the camera sees moves by 0.15 m and the arm by nothing."""
    places = [se3.transform(np.eye(3), (0.03 * k, 0.0, 0.0)) for k in range(6)]
    odometry = StereoOdometry(camera, config.odometry)
    for k, X in enumerate(places):
        found = odometry.process(pair_at(camera, texture, X, seed=k), X_BT=told(places[0]))
    assert found is None
    assert odometry.last_loss == "sudden_motion"
