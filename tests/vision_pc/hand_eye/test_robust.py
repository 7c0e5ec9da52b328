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
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.motions import all_motions
from vision_pc.core.hand_eye.solvers.result import verdict


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


def test_too_little_agreement_is_refused_by_name() -> None:
    pairs, _ = noisy_pairs([2, 5], 5, 0.05, 0.2)
    P = pairs.P.copy()
    P[4] = random_poses(np.random.default_rng([2, 5]), 1)[0]
    with pytest.raises(MeasurementFailed, match="of 5 samples agree") as caught:
        methods.solve(pose_pairs(pairs.X_BT, P))
    assert caught.value.cause == "measurement.hand_eye.no_consensus"


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
