"""What is believed of a calibration: right samples are good, whatever their noise; doubts have figures."""

import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import noisy_pairs
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import judgement, methods, readings
from vision_pc.core.hand_eye.solvers.judgement import JudgementLimits
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations


@pytest.mark.parametrize(("rotation_deg", "translation_mm"), [(0.05, 0.3), (1.0, 6.0)])
def test_right_samples_are_good(rotation_deg: float, translation_mm: float) -> None:
    for seed, count in ((61, 6), (62, 7)):
        pairs, _ = noisy_pairs(seed, count, rotation_deg, translation_mm)
        found = judgement.judged(pairs, methods.solve(pairs))
        assert found.doubts == ()
        assert found.verdict == "good"


def test_few_samples_are_said_not_to_tell() -> None:
    pairs, _ = noisy_pairs(64, 4)
    found = judgement.judged(pairs, methods.solve(pairs))
    assert [doubt.cause for doubt in found.doubts] == ["measurement.hand_eye.few_samples"]
    assert found.scale is None


def scaled(pairs: PosePairs, factor: float) -> PosePairs:
    P = stacks.transform(pairs.P[:, :3, :3], factor * pairs.P[:, :3, 3])
    return pose_pairs(pairs.X_BT, P, pairs.setup)


def test_scale_is_told_with_an_honest_sigma() -> None:
    errors, n = [], scenes.noise(0.1, 0.5)
    for seed in range(30):
        pairs, scene = noisy_pairs([65, seed], 12)
        equations = Equations(pairs.H, scaled(pairs, 1.0 / 1.03).P, np.ones(12))
        found, shift = readings.refined_scale(equations, scene.X, scene.Z, n)
        assert found.factor == pytest.approx(1.03, abs=0.01)
        assert shift == pytest.approx(0.5e-3, rel=0.5)
        errors.append((found.factor - 1.03) / found.std)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_noise_is_questioned_and_refused_with_its_limit() -> None:
    pairs, _ = noisy_pairs(66, 9, 3.0, 5.0)
    result = methods.solve(pairs)
    (doubt,) = judgement.judged(pairs, result).doubts
    assert doubt.cause == "measurement.hand_eye.noise"
    assert "limit 2 deg" in doubt.reason
    assert not doubt.refused
    strict = judgement.judged(pairs, result, JudgementLimits(noise_deg=0.2))
    with pytest.raises(MeasurementFailed, match="noise is"):
        strict.demand()


def test_corner_noise_is_questioned_and_refused_with_its_limit() -> None:
    assert judgement.corner_doubt(0.2) is None
    questioned, refused = judgement.corner_doubt(0.58), judgement.corner_doubt(2.0)
    assert questioned is not None
    assert refused is not None
    assert "0.580 px, limit 0.3 px" in questioned.reason
    assert (questioned.refused, refused.refused) == (False, True)


def test_an_error_without_a_better_reading_stays_as_it_is() -> None:
    pairs, _ = noisy_pairs(67, 8)
    error = MeasurementFailed("measurement.hand_eye.no_consensus", "as it was")
    assert judgement.explained(pairs, error) is error


def test_two_mistakes_at_once_are_named() -> None:
    pairs = scaled(noisy_pairs(68, 8)[0], 1e-3)
    inverted = pose_pairs(pairs.X_BT, stacks.inverse(pairs.P))
    told = judgement.judged(inverted, methods.solve(inverted)).doubts[0]
    assert told.cause == "measurement.hand_eye.misread"
    assert "camera poses are inverted, and camera lengths have to be multiplied by" in told.reason
    assert readings.others(inverted)[0].scale == pytest.approx(1e3, rel=0.02)
