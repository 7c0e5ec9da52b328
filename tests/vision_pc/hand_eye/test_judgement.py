"""What is believed of a calibration: right samples are good, whatever their noise; doubts have figures."""

import cv2
import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import noisy_pairs
from vision_pc.config.choices import Method, Setup
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import CornerViews, PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import judgement, methods, readings
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


def test_a_target_behind_the_camera_is_asked_about() -> None:
    """OpenGL's axes fit as well as OpenCV's: X is that of another camera."""
    pairs, _ = noisy_pairs(61, 6)
    backwards = pose_pairs(pairs.X_BT, np.diag([1.0, -1.0, -1.0, 1.0]) @ pairs.P, pairs.setup)
    found = judgement.judged(backwards, methods.solve(backwards))
    assert [doubt.cause for doubt in found.doubts] == ["measurement.hand_eye.behind"]


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


def test_noise_is_questioned_and_refused_with_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs, _ = noisy_pairs(66, 9, 3.0, 5.0)
    result = methods.solve(pairs)
    (doubt,) = judgement.judged(pairs, result).doubts
    assert doubt.cause == "measurement.hand_eye.noise"
    assert "limit 2 deg" in doubt.reason
    assert not doubt.refused
    monkeypatch.setattr(judgement, "_NOISE_DEG", 0.2)
    strict = judgement.judged(pairs, result)
    with pytest.raises(MeasurementFailed, match="noise is"):
        strict.demand()


@pytest.mark.parametrize(("shift_px", "verdict"), [(0.0, "good"), (100.0, "questioned"), (200.0, "refused")])
def test_corners_tell_that_the_camera_is_another(shift_px: float, verdict: str) -> None:
    scene = scenes.viewing_scene(np.random.default_rng(1), 12, distance_m=0.4, tilt_deg=35.0)
    points = np.array([(x, y, 0.0) for x in np.arange(-3, 4) for y in np.arange(-3, 4)]) * 0.024
    K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
    given = np.array([[600.0, 0.0, 320.0 + shift_px], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
    seen = [se3.apply(X, points) @ K.T for X in scene.P()]
    pixels = np.stack([each[:, :2] / each[:, 2:] for each in seen])
    poses = [cv2.solvePnP(points, each, given, None, flags=cv2.SOLVEPNP_IPPE)[1:] for each in pixels]
    X_CP = np.stack([se3.transform(se3.exp_so3(turn.ravel()), place.ravel()) for turn, place in poses])
    corners = CornerViews(points, pixels, given, np.zeros(5))
    pairs = pose_pairs(scene.X_BT, X_CP, Setup.EYE_IN_HAND, corners=corners)
    found = judgement.judged(pairs, methods.solve(pairs, Method.DQCR))
    of_corners = [each.refused for each in found.doubts if each.cause == "measurement.hand_eye.corner_noise"]
    assert of_corners == {"good": [], "questioned": [False], "refused": [True]}[verdict]


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
