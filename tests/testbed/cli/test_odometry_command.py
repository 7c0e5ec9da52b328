"""`longreach odometry` on a short recording: a trajectory that fits the truth, and refusals that name the
directory.
"""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from foundation.configuration import load
from testbed.cli.main import app
from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import wall_texture
from tests.vision_pc.shell.test_sequence import YAML, written
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics


@pytest.fixture
def vision_config() -> VisionConfig:
    return load(VisionConfig, Path("configs/vision.yaml"))


@pytest.mark.slow("pictures are drawn and followed")
def test_a_recording_becomes_a_trajectory(vision_config: VisionConfig, tmp_path: Path) -> None:
    camera = intrinsics.calibration(vision_config.camera)
    true = [se3.transform(np.eye(3), (0.04 * k, 0.01 * k, 0.0)) for k in range(3)]
    texture = wall_texture(1, 22.0, 1000)
    left, right = written(
        tmp_path, [pair_at(camera, texture, X, seed=k) for k, X in enumerate(true)], ["0", "1", "2"]
    )
    (tmp_path / "calib.yaml").write_text(YAML)
    path = tmp_path / "path.tum"
    arguments = ["--left", left, "--right", right, "--calib", tmp_path / "calib.yaml", "--out", path]
    result = CliRunner().invoke(app, ["odometry", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    assert "3 pairs, none lost" in result.output
    rows = np.loadtxt(path)
    np.testing.assert_allclose(rows[:, 1:4], [X[:3, 3] for X in true], atol=0.2e-3)


def recorded(vision_config: VisionConfig, tmp_path: Path, tool: str) -> list[str]:
    """The command's arguments for three pairs at 10 Hz and a file of tool poses that holds ``tool``."""
    camera = intrinsics.calibration(vision_config.camera)
    texture = wall_texture(1, 22.0, 1000)
    true = [se3.transform(np.eye(3), (0.04 * k, 0.01 * k, 0.0)) for k in range(3)]
    left, right = written(
        tmp_path, [pair_at(camera, texture, X, seed=k) for k, X in enumerate(true)], ["0", "1", "2"]
    )
    (tmp_path / "calib.yaml").write_text(YAML)
    (tmp_path / "tool.tum").write_text(tool)
    options = {"left": left, "right": right, "calib": tmp_path / "calib.yaml", "out": tmp_path / "path.tum"}
    options["tool-poses"] = tmp_path / "tool.tum"
    return ["odometry", *(str(word) for name, value in options.items() for word in (f"--{name}", value))]


def lines(times_s: list[float], speed: float) -> str:
    """Poses of a tool that goes along x."""
    return "".join(f"{t} {speed * t} 0 0 0 0 0 1\n" for t in times_s)


@pytest.mark.slow("pictures are drawn and followed")
def test_the_arms_poses_are_believed(vision_config: VisionConfig, tmp_path: Path) -> None:
    """The camera went 41 mm a pair: an arm that tells of as much agrees, one that rested does not."""
    between = [-0.05, 0.05, 0.15, 0.25]  # no pose at a pair's very time
    went = CliRunner().invoke(app, recorded(vision_config, tmp_path, lines(between, 0.412)))
    assert went.exit_code == 0, went.output
    assert "3 pairs, none lost" in went.output
    (tmp_path / "rested").mkdir()
    rested = CliRunner().invoke(app, recorded(vision_config, tmp_path / "rested", lines(between, 0.0)))
    assert rested.exit_code == 1
    assert "sudden_motion" in rested.output


@pytest.mark.slow("pictures are drawn and followed")
@pytest.mark.parametrize(
    ("tool", "said"),
    [
        (lines([100.0, 101.0], 0.1), "100.000 to 101.000 s, and no pair was taken then"),
        (lines([-1.0, 1.0], 0.1), "no pair was taken then"),  # two seconds apart: nothing between is known
        ("0 0 0 0\n", "lines of t x y z qx qy qz qw are wanted, 4 columns were found"),
    ],
)
def test_tool_poses_that_say_nothing_of_the_pairs_are_refused(
    vision_config: VisionConfig, tmp_path: Path, tool: str, said: str
) -> None:
    result = CliRunner().invoke(app, recorded(vision_config, tmp_path, tool))
    assert result.exit_code == 2
    assert "configuration.bad_trajectory" in result.stderr
    assert "tool.tum" in result.stderr
    assert said in " ".join(result.stderr.split())
