"""The page's node that positions by vision through ROS alone, judged by the emulator's truth."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from testbed.recordings.plant_truth import read_truth
from tests.longreach_ros2.bridge.rig import PYTHON, bridged, environment, needs_ros
from tests.support.paths import ROOT

pytestmark = [pytest.mark.realtime, needs_ros]
DOMAIN = 65
CLEARANCE_M = 0.1


@pytest.mark.slow("a dozen motions and looks in real time")
def test_a_node_that_knows_ros_alone_positions_within_five_millimetres(tmp_path: Path) -> None:
    with bridged(tmp_path, DOMAIN, recorded=True) as rig:
        node = subprocess.run(
            [str(PYTHON), "examples/ros2/position.py"],
            cwd=ROOT,
            env=environment(DOMAIN),
            capture_output=True,
            text=True,
            timeout=500.0,
            check=False,
        )
    assert node.returncode == 0, node.stderr[-2000:]
    truth = read_truth(rig.records / "truth.mcap")
    p_CM, p_CO = truth.stacked("p_CM"), truth.stacked("p_CO")
    began_m, ended_m = (np.linalg.norm((p_CO - p_CM)[k] - (0.0, 0.0, CLEARANCE_M)) for k in (0, -1))
    print(f"from {1e3 * began_m:.0f} mm to {1e3 * ended_m:.2f} mm\n{node.stdout}")
    assert began_m > 0.5
    assert ended_m < 0.005
