"""Real ROS 2 beside the three services: what the live face shows, in standard messages."""

import subprocess
import time
from collections.abc import Iterator

import numpy as np
import pytest

from tests.integration.services import Running
from tests.longreach_ros2.bridge.rig import PYTHON, Talk, environment, needs_ros, watched
from tests.support.crash_trials import until_healthy
from tests.support.paths import CONFIGS, ROOT

pytestmark = [pytest.mark.realtime, needs_ros]
DOMAIN = 64


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Talk, Running]]:
    with watched(tmp_path_factory.mktemp("watch"), DOMAIN) as started:
        until_healthy(started[1].face)
        yield started


@pytest.mark.slow("four processes start, and vision looks")
def test_pictures_lenses_markers_and_truth_are_shown(rig: tuple[Talk, Running]) -> None:
    talk, services = rig
    talk.start(step="hear", kind="Image", topic="/camera/left/image_raw")
    talk.start(step="hear", kind="PoseStamped", topic="/seen/object")
    time.sleep(1.0)
    waiting = {"Prefer": "wait=60"}
    for _ in range(3):
        services.face.post("/operations/look", json={}, headers=waiting, timeout=70.0)
    seen, picture = talk.heard(topic="/seen/object"), talk.heard(topic="/camera/left/image_raw")
    assert (picture["width"], picture["height"], picture["bytes"]) == (1280, 720, 1280 * 720)
    assert (picture["encoding"], picture["frame"]) == ("mono8", "camera_left_optical")
    assert picture["levels"] > 50
    truth = talk.hear(kind="PoseStamped", topic="/truth/tool_pose")
    believed = talk.hear(kind="PoseStamped", topic="/longreach/tool_pose")
    assert truth["frame"] == "true/base"
    assert 0.0 < np.linalg.norm(np.subtract(truth["p"], believed["p"])) < 0.1
    assert seen["frame"] == "camera_left_optical"
    assert 0.3 < seen["p"][2] < 5.0
    assert all(name.startswith("true/") for name in talk.hear(kind="TFMessage", topic="/truth/tf"))


@pytest.mark.slow("a process starts")
def test_a_face_that_nobody_serves_ends_the_node_with_one_line() -> None:
    command = [
        str(PYTHON),
        "-m",
        "longreach_ros2",
        "--watch",
        "ws://127.0.0.1:9",
        "--config-dir",
        str(CONFIGS),
    ]
    ended = subprocess.run(
        command, env=environment(DOMAIN), cwd=ROOT, capture_output=True, text=True, timeout=60.0, check=False
    )
    assert ended.returncode == 2
    assert "link.no_live_face: live face at ws://127.0.0.1:9" in ended.stderr.splitlines()[-1]
