"""Where to sample next: bounds kept, information maximised, refusals learned from."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.still_rig import X_BT_START, still_settings
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import sampling as guided_sampling
from vision_pc.core.hand_eye.guided import views as guided_views
from vision_pc.core.hand_eye.guided.sampling import Belief
from vision_pc.core.hand_eye.guided.views import Surroundings
from vision_pc.core.hand_eye.samples import pose_pairs
from vision_pc.core.hand_eye.solvers.maximum_likelihood import predicted
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array

SETTINGS = GuidedSettings()
CAMERA = intrinsics.calibration(still_settings().vision.camera)
X_TC = guided_views.nominal_mount(SETTINGS) @ se3.transform(
    se3.exp_so3([0.05, -0.04, 0.03]), [0.01, -0.01, 0.005]
)
X_CP_START = se3.transform(np.diag([1.0, -1.0, -1.0]), [-0.05, 0.02, 0.8])
Z = X_BT_START @ X_TC @ X_CP_START
AROUND = guided_views.surroundings(
    CAMERA, X_BT_START, se3.transform(np.diag([1.0, -1.0, -1.0]), [0.2, 0.05, 0.4]),
    still_settings().vision.markers.tool.carried_m, SETTINGS,
)  # fmt: skip


class Taken(NamedTuple):
    """A belief after a session without noise, and the poses it went to."""

    belief: Belief
    poses: list[Array]


def session(samples: int, informative: bool, seed: int = 1) -> Taken:
    """Exact samples, each at the pose proposed."""
    poses = [X_BT_START]
    while True:
        H = np.stack(poses)
        belief = guided_sampling.believed(pose_pairs(H, predicted(H, X_TC, Z)), AROUND, SETTINGS)
        if len(poses) == samples:
            return Taken(belief, poses)
        rng = np.random.default_rng([seed, len(poses)])
        poses.append(guided_sampling.propose(belief, AROUND, SETTINGS, rng, informative=informative).X_BT)


def test_every_proposal_keeps_view_turn_reach_and_clearance() -> None:
    belief = session(4, True).belief
    for seed in range(30):
        rng = np.random.default_rng(seed)
        proposal = guided_sampling.propose(belief, AROUND, SETTINGS, rng, informative=seed % 2 == 0)
        X_CP = predicted(proposal.X_BT[None], belief.X, belief.Z)[0]
        assert np.allclose(X_CP, proposal.X_CP, atol=1e-9)
        assert 0.55 <= np.linalg.norm(X_CP[:3, 3]) <= 0.85
        assert math.degrees(proposal.obliquity) <= 40.001
        assert math.degrees(se3.angle_between(proposal.X_BT[:3, :3], X_BT_START[:3, :3])) <= 60.001
        assert np.linalg.norm(proposal.X_BT[:3, 3] - X_BT_START[:3, 3]) <= 0.6
        tool_above_plane = (np.array([0.2, 0.05, 0.4]) - X_CP[:3, 3]) @ X_CP[:3, 2]
        assert tool_above_plane >= 0.08
        corners = np.array([[x, y, 0.0] for x in (-0.0375, 0.0375) for y in (-0.0375, 0.0375)])
        for eye, hidden in zip((CAMERA.left, CAMERA.right), AROUND.hidden, strict=True):
            pixels = intrinsics.project(eye, se3.apply(X_CP, corners))
            assert (pixels > 39.9).all()
            assert (pixels < np.array([1240.1, 680.1])).all()
            for u0, v0, u1, v1 in hidden:
                outside = (
                    (pixels[:, 0] < u0) | (pixels[:, 0] > u1) | (pixels[:, 1] < v0) | (pixels[:, 1] > v1)
                )
                assert outside.all()


def test_informative_poses_tell_more_than_random_ones() -> None:
    guided = session(6, True).belief.std
    others = np.array([session(6, False, seed).belief.std for seed in range(5)])
    assert guided[0] < 0.8 * np.median(others[:, 0])
    assert guided[1] < np.median(others[:, 1])


def test_belief_finds_the_mount_and_forgives_one_bad_sample() -> None:
    taken = session(8, True)
    assert np.linalg.norm(taken.belief.X[:3, 3] - X_TC[:3, 3]) < 1e-4
    H = np.stack(taken.poses)
    P = predicted(H, X_TC, Z)
    P[3] = se3.retract(P[3], [0.15, 0.0, 0.1, 0.2, 0.3, 0.0])
    spoiled = guided_sampling.believed(pose_pairs(H, P), AROUND, SETTINGS)
    assert np.linalg.norm(spoiled.X[:3, 3] - X_TC[:3, 3]) < 0.01


def test_neighbours_of_a_refused_pose_are_not_proposed() -> None:
    belief = session(3, True).belief
    best = guided_sampling.propose(belief, AROUND, SETTINGS, np.random.default_rng(7))
    again = guided_sampling.propose(belief, AROUND, SETTINGS, np.random.default_rng(7), [best.X_BT])
    assert again.choices < best.choices
    turn = se3.angle_between(again.X_BT[:3, :3], best.X_BT[:3, :3])
    assert turn > math.radians(12.0) or np.linalg.norm(again.X_BT[:3, 3] - best.X_BT[:3, 3]) > 0.1


def test_no_pose_left_is_said() -> None:
    tight = SETTINGS.model_copy(update={"clearance_m": 1.0})
    with pytest.raises(MeasurementFailed, match="none of 800 views") as refused:
        guided_sampling.propose(session(2, True).belief, AROUND, tight, np.random.default_rng(1))
    assert refused.value.cause == "measurement.hand_eye.no_pose"


def test_the_hidden_regions_are_those_of_both_eyes() -> None:
    assert isinstance(AROUND, Surroundings)
    (left, *_), (right, *_) = AROUND.hidden
    assert left[0] - right[0] == pytest.approx(530.0 * 0.12 / 0.4, abs=2.0)
