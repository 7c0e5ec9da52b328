"""`longreach odometry` on a short recording: a trajectory that fits the truth, and refusals that name the
directory.
"""

from pathlib import Path

import numpy as np
import pytest

from testbed.scenarios.scenario import Settings
from tests.support.commands import ran
from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import wall_texture
from tests.vision_pc.shell.test_sequence import YAML, written
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics


@pytest.mark.slow("pictures are drawn and followed")
def test_a_recording_becomes_a_trajectory(shipped_settings: Settings, tmp_path: Path) -> None:
    camera = intrinsics.calibration(shipped_settings.vision.camera)
    true = [se3.transform(np.eye(3), (0.04 * k, 0.01 * k, 0.0)) for k in range(3)]
    texture = wall_texture(1, 22.0, 1000)
    left, right = written(
        tmp_path, [pair_at(camera, texture, X, seed=k) for k, X in enumerate(true)], ["0", "1", "2"]
    )
    (tmp_path / "calib.yaml").write_text(YAML)
    path = tmp_path / "path.tum"
    arguments = ["--left", left, "--right", right, "--calib", tmp_path / "calib.yaml", "--out", path]
    assert "3 pairs, none lost" in ran("odometry", *arguments).output
    rows = np.loadtxt(path)
    np.testing.assert_allclose(rows[:, 1:4], [X[:3, 3] for X in true], atol=0.2e-3)
