"""The certified robust solver: bad samples out, good ones kept, honest about what it does not know."""

import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import noisy_pairs, random_poses
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import pose_pairs
from vision_pc.core.hand_eye.solvers import consensus, methods
from vision_pc.core.hand_eye.solvers.methods import RobustSettings
from vision_pc.core.hand_eye.solvers.motions import Motions, all_motions
from vision_pc.core.hand_eye.solvers.noise import NoiseSource
from vision_pc.core.hand_eye.solvers.result import ObservabilityLimits, verdict


@pytest.mark.parametrize(("samples", "bad"), [(15, 2), (15, 5), (30, 12)])
def test_bad_samples_are_found_and_no_others(samples: int, bad: int) -> None:
    n = scenes.noise(0.1, 1.0)
    for run in range(4):
        rng = np.random.default_rng([samples, run])
        scene = scenes.viewing_scene(rng, samples)
        pairs, spoiled = scenes.measured_with_bad(scene, n, rng, bad)
        result = methods.solve(pairs)
        dropped = {name for name, used in zip(result.names, result.inliers, strict=True) if not used}
        assert dropped == spoiled
        assert result.certificate is not None
        assert result.certificate.holds
        bound = scenes.bound(scene, n)
        assert np.degrees(se3.angle_between(result.X[:3, :3], scene.X[:3, :3])) < 4.0 * bound.rotation_deg


def test_one_axis_of_error_is_enough_to_be_found() -> None:
    """A sample whose rotation is right and whose position is 20 mm off, at 0.5 mm noise."""
    pairs, _ = noisy_pairs(21, 15)
    P = pairs.P.copy()
    P[6, :3, 3] += (0.0, 0.02, 0.0)
    result = methods.solve(pose_pairs(pairs.X_BT, P))
    assert [int(name) for name, used in zip(result.names, result.inliers, strict=True) if not used] == [7]


def test_too_little_agreement_is_refused_by_name() -> None:
    rng = np.random.default_rng(22)
    hand, camera = random_poses(rng, 12), random_poses(rng, 12)
    with pytest.raises(MeasurementFailed, match="of 12 samples agree") as caught:
        methods.solve(pose_pairs(hand, camera), Method.ROBUST, RobustSettings(noise=scenes.noise(0.1, 1.0)))
    assert caught.value.cause == "measurement.hand_eye.no_consensus"


def test_four_samples_are_all_used_and_that_is_said() -> None:
    pairs, scene = noisy_pairs(23, 4)
    result = methods.solve(pairs)
    assert result.inliers.all()
    assert any("too few to tell a bad one" in note for note in result.notes)
    assert np.linalg.norm(result.X[:3, 3] - scene.X[:3, 3]) < 0.02


def test_given_noise_is_kept_and_questioned() -> None:
    pairs, _ = noisy_pairs(24, 15, 0.1, 0.5)
    honest = methods.solve(pairs, Method.ROBUST, RobustSettings(noise=scenes.noise(0.1, 0.5)))
    assert honest.noise == scenes.noise(0.1, 0.5)
    assert honest.notes == ()
    modest = methods.solve(pairs, Method.ROBUST, RobustSettings(noise=scenes.noise(0.5, 2.5)))
    assert any("times what the given noise explains" in note for note in modest.notes)


@pytest.mark.parametrize(("robot", "source"), [(False, NoiseSource.CAMERA), (True, NoiseSource.ROBOT)])
def test_errors_are_what_the_covariance_says(robot: bool, source: NoiseSource) -> None:
    """Mean NEES near 6 with the source unknown; far from it when the other one is assumed."""
    n = scenes.noise(0.1, 0.3, robot)
    free, wrong = [], []
    for run in range(14):
        rng = np.random.default_rng([25, run])
        scene = scenes.viewing_scene(rng, 20)
        pairs = scenes.measured(scene, n, rng)
        other = NoiseSource.ROBOT if source is NoiseSource.CAMERA else NoiseSource.CAMERA
        for sources, sink in ((NoiseSource.BOTH, free), (other, wrong)):
            result = methods.solve(pairs, Method.ROBUST, RobustSettings(source=sources))
            assert result.covariance is not None
            error = se3.local(result.X, scene.X)
            sink.append((error @ np.linalg.solve(result.covariance, error), error @ error))
    assert 4.0 < np.mean(free, axis=0)[0] < 8.5
    assert np.mean(free, axis=0)[1] < 0.5 * np.mean(wrong, axis=0)[1]


def test_reruns_are_bit_identical() -> None:
    pairs, _ = noisy_pairs(26, 15)
    first, second = methods.solve(pairs), methods.solve(pairs)
    assert np.array_equal(first.X, second.X)
    assert first.covariance is not None
    assert second.covariance is not None
    assert np.array_equal(first.covariance, second.covariance)


def test_truncated_weights_end_at_zero_and_one() -> None:
    squares = np.array([0.0, 10.0, 30.0, 1e6])
    early = consensus._truncated_weights(squares, 24.0, 1e-5)
    late = consensus._truncated_weights(squares, 24.0, 1e5)
    assert ((early > 0.0) & (early <= 1.0)).all()
    np.testing.assert_allclose(late, [1.0, 1.0, 0.0, 0.0], atol=1e-3)


def test_parallel_axes_are_refused_by_every_method() -> None:
    rng = np.random.default_rng(27)
    scene = scenes.viewing_scene(rng, 12)
    spin = np.zeros((12, 3))
    spin[:, 2] = rng.uniform(-1.0, 1.0, 12)
    hand = stacks.transform(stacks.exp_so3(spin), rng.normal(size=(12, 3)) * 0.3)
    planar = scene._replace(X_BT=hand)
    exact = pose_pairs(hand, planar.P())
    noisy = scenes.measured(planar, scenes.noise(0.1, 0.5), rng)
    shaken = scenes.measured(planar, scenes.noise(0.2, 0.5, robot=True), rng)
    for pairs in (exact, noisy, shaken):
        for method in Method:
            with pytest.raises(MeasurementFailed, match="parallel") as caught:
                methods.solve(pairs, method)
            assert caught.value.cause == "measurement.hand_eye.parallel_axes"


def test_parallel_axes_hidden_by_a_bad_sample_are_refused_too() -> None:
    rng = np.random.default_rng(28)
    scene = scenes.viewing_scene(rng, 12)
    spin = np.zeros((12, 3))
    spin[:, 2] = rng.uniform(-1.0, 1.0, 12)
    planar = scene._replace(X_BT=stacks.transform(stacks.exp_so3(spin), rng.normal(size=(12, 3)) * 0.3))
    P = scenes.measured(planar, scenes.noise(0.05, 0.3), rng).P
    hand = scenes.measured(planar, scenes.noise(0.05, 0.3), np.random.default_rng(28)).X_BT
    hand = hand.copy()
    hand[4] = random_poses(rng, 1)[0]
    with pytest.raises(MeasurementFailed):
        methods.solve(pose_pairs(hand, P))


def test_too_few_and_too_still_are_refused() -> None:
    pairs, _ = noisy_pairs(29, 12)
    with pytest.raises(MeasurementFailed, match="2 samples are too few") as caught:
        methods.solve(pairs.subset(np.arange(12) < 2))
    assert caught.value.cause == "measurement.hand_eye.too_few_samples"
    rng = np.random.default_rng(30)
    scene = scenes.small_rotation_scene(rng, 12, largest_deg=0.5)
    with pytest.raises(MeasurementFailed, match="largest rotation") as caught:
        methods.solve(scenes.measured(scene, scenes.noise(0.01, 0.1), rng))
    assert caught.value.cause == "measurement.hand_eye.too_little_rotation"


def test_small_rotations_are_accepted_when_the_noise_allows() -> None:
    rng = np.random.default_rng(31)
    scene = scenes.small_rotation_scene(rng, 20)
    quiet = scenes.measured(scene, scenes.noise(0.05, 0.5), rng)
    assert verdict(20, all_motions(quiet)).cause is None
    loud = scenes.measured(scene, scenes.noise(1.5, 5.0), rng)
    assert verdict(20, all_motions(loud)).cause == "measurement.hand_eye.parallel_axes"


def test_verdict_counts_what_it_saw() -> None:
    turns = np.radians([[20.0, 0.0, 0.0], [0.0, 10.0, 0.0], [20.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
    A = stacks.transform(stacks.exp_so3(turns), np.zeros((4, 3)))
    seen = verdict(5, Motions(A, A))
    assert np.degrees(seen.largest_rotation) == pytest.approx(20.0)
    assert np.degrees(seen.second_axis) == pytest.approx(10.0 / np.sqrt(2.0))
    assert seen.mismatch == pytest.approx(0.0, abs=1e-12)
    strict = verdict(5, Motions(A, A), ObservabilityLimits(second_axis=np.radians(8.0)))
    assert strict.cause == "measurement.hand_eye.parallel_axes"


def test_neither_side_s_noise_vanishes() -> None:
    """All noise is the robot's; the likelihood alone calls the camera's 45 and 210 times smaller in these."""
    for run in (3, 4):
        rng = np.random.default_rng([32, run])
        pairs = scenes.measured(scenes.viewing_scene(rng, 20), scenes.noise(0.1, 0.3, robot=True), rng)
        found = methods.solve(pairs, Method.MAXIMUM_LIKELIHOOD).noise
        assert found is not None
        assert 1.0 / 30.0 < found.camera_rotation / found.robot_rotation < 0.5


@pytest.mark.parametrize(
    ("samples", "said"), [(5, "all is taken as the camera's"), (7, "mostly the prior's")]
)
def test_few_samples_say_how_their_noise_is_split(samples: int, said: str) -> None:
    pairs, _ = noisy_pairs(33, samples)
    assert any(said in note for note in methods.solve(pairs).notes)
