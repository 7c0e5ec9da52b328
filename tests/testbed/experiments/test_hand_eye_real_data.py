"""Recorded sets of others, where they are: see docs/hand_eye.md for what is expected of them."""

import numpy as np
import pytest

from protocol.errors import RequestRefused
from testbed.experiments.hand_eye import real_data
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.samples import pose_pairs
from vision_pc.core.hand_eye.solvers import methods

try:
    real_data.data_directory()
except RequestRefused as absent:
    pytest.skip(str(absent), allow_module_level=True)


def test_moveit_samples_give_the_published_camera() -> None:
    result = methods.solve(real_data.moveit())
    assert result.inliers.all()
    reference = real_data.moveit_reference()
    gap = np.linalg.norm(result.X[:3, 3] - reference[:3, 3])
    assert gap < 0.01 * np.linalg.norm(reference[:3, 3])
    # the reference's angles in their other branch: (a + π, π − b, c + π) is the same rotation
    a, b, c = se3.euler_xyz(result.X[:3, :3])
    angles = np.array([a + np.pi, b - np.sign(b) * np.pi if abs(b) > 2 else -np.pi - b, c + np.pi])
    assert np.linalg.norm(angles - real_data.MOVEIT_EULER_XYZ) < 0.01 * np.linalg.norm(
        real_data.MOVEIT_EULER_XYZ
    )
    assert result.certificate is not None
    assert result.certificate.holds


def test_moveit_hold_out() -> None:
    rows = real_data.hold_out("moveit", real_data.moveit(), only=[Method.HORAUD, Method.DQCR, Method.ROBUST])
    for row in rows:
        assert row.hold_out_mm < 4.9, row.method


def test_moveit_with_bad_samples_keeps_the_camera() -> None:
    pairs = real_data.moveit()
    rng = np.random.default_rng(1)
    P = pairs.P.copy()
    spoiled = rng.choice(50, 8, replace=False)
    for k in spoiled:
        P[k, :3, 3] += rng.normal(size=3) * 0.1
    result = methods.solve(pose_pairs(pairs.X_BT, P, pairs.setup))
    assert set(np.flatnonzero(~result.inliers)) == set(spoiled)
    assert np.linalg.norm(result.X[:3, 3] - real_data.moveit_reference()[:3, 3]) < 0.003


def test_ethz_hold_out() -> None:
    pairs = real_data.ethz()
    rows = {r.method: r for r in real_data.hold_out("ethz", pairs, only=[Method.HORAUD, Method.ROBUST])}
    assert rows["robust"].hold_out_mm <= 1.6
    assert rows["robust"].hold_out_mm < rows["horaud"].hold_out_mm


def test_checkerboards_give_opencvs_focal_length() -> None:
    rows = {r.detector: r for r in real_data.checkerboards()}
    assert rows["classic"].fx_px == pytest.approx(real_data.OPENCV_FX_PX, rel=0.003)
    assert rows["classic"].outlying == ("left02",)
    assert rows["fitted"].rms_px < 0.2 < rows["sectors"].rms_px < 0.25 < rows["classic"].rms_px
    assert rows["fitted"].std_fx_px < 0.5 * rows["classic"].std_fx_px
