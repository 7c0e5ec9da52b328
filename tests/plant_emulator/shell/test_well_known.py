"""Other people's readers find in the plant's recording what they know: frames in one tree, a drawing."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from foundation.configuration import load
from foundation.recording.beginning import SESSION_VARIABLE, session_entries
from foundation.recording.messages import DirectRecording
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.faults.kinds import SupplyLost
from plant_emulator.core.plant import Plant
from plant_emulator.shell.scene_messages import CAMERA, TOOL, drawing
from plant_emulator.shell.truth_recorder import CAMERA as CALIBRATION
from plant_emulator.shell.truth_recorder import CAPTURE, EVENT, FRAMES, LOG, SCENE, TOPICS, TruthRecorder
from testbed.recordings.plant_truth import read_truth
from tests.plant_emulator.plant_world import Driver, plant_config
from tests.support.paths import CONFIGS
from tests.support.rerun import needs_rerun, rerun

SCENE_CONFIG = load(SceneConfig, CONFIGS / "scene.yaml")
SESSION = session_entries("plant_emulator", {SESSION_VARIABLE: "7"})


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in simulated time: five truths of a moving arm, and a fault."""
    path = tmp_path_factory.mktemp("run") / "truth.mcap"
    plant = Plant(plant_config(), 1, Scene(SCENE_CONFIG).mounts)
    driver = Driver(plant)
    drawn = drawing(SCENE_CONFIG, plant.chain, 0)
    recorder = TruthRecorder(path, {}, drawn, SESSION, DirectRecording)
    for _ in range(5):
        driver.run(0.02, (0.4, 0.2, 0.0, 0.0, 0.0, 0.0))
        recorder.truth(plant.truth(), plant.time_ns, plant.links())
    plant.inject(SupplyLost())
    for change in plant.faults.changes:
        recorder.fault(change, plant.time_ns)
    recorder.close()
    return path


def decoded(path: Path, topic: str) -> list[Any]:
    """All messages of ``topic``, as the library of the format's makers decodes them."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [said for _, _, _, said in reader.iter_decoded_messages(topics=[topic])]


def pose(transform: Any) -> np.ndarray[Any, Any]:
    """The (4, 4) of a foxglove.FrameTransform."""
    X, p, q = np.eye(4), transform.translation, transform.rotation
    X[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    X[:3, 3] = p.x, p.y, p.z
    return X


def test_every_frame_has_one_parent_and_the_truth_pose(recorded: Path) -> None:
    truths = read_truth(recorded).truths
    for record, said in zip(truths, decoded(recorded, FRAMES), strict=True):
        frames = {each.child_frame_id: each for each in said.transforms}
        assert len(frames) == len(said.transforms)
        assert {each.parent_frame_id for each in said.transforms} == {"world"}
        for name, X in ((TOOL, record.truth.X_WT), (CAMERA, record.truth.X_WC)):
            np.testing.assert_allclose(pose(frames[name]), X, atol=1e-12)
        stamp = frames[TOOL].timestamp
        assert stamp.seconds * 10**9 + stamp.nanos == record.log_ns


def test_the_drawn_links_hang_together_and_end_at_the_tool(recorded: Path) -> None:
    """Each cylinder, moved by its frame, begins where the one before it ends."""
    (scene,) = decoded(recorded, SCENE)
    links = [entity for entity in scene.entities if entity.cylinders and entity.id == entity.frame_id]
    assert len(links) >= 5
    ends = []
    for record, said in zip(read_truth(recorded).truths, decoded(recorded, FRAMES), strict=True):
        frames = {each.child_frame_id: pose(each) for each in said.transforms}
        reached = record.truth.X_WB[:3, 3]
        for link in links:
            (cylinder,) = link.cylinders
            q, p = cylinder.pose.orientation, cylinder.pose.position
            along = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()[:, 2] * cylinder.size.z
            middle = np.array([p.x, p.y, p.z])
            begun, ended = (
                frames[link.frame_id] @ np.array([*(middle + share * along), 1.0]) for share in (-0.5, 0.5)
            )
            np.testing.assert_allclose(begun[:3], reached, atol=2e-3)  # shorter links are not drawn
            reached = ended[:3]
        np.testing.assert_allclose(reached, record.truth.X_WT[:3, 3], atol=2e-3)
        ends.append(reached)
    assert np.linalg.norm(ends[-1] - ends[0]) > 1e-4  # it did move


def test_the_scene_has_wall_and_markers_in_frames_that_are_told(recorded: Path) -> None:
    (scene,) = decoded(recorded, SCENE)
    told = {each.child_frame_id for each in decoded(recorded, FRAMES)[0].transforms}
    assert {entity.frame_id for entity in scene.entities} <= told
    assert {entity.id for entity in scene.entities} >= {
        "wall",
        "marker 1",
        "marker 2",
        "marker 3",
        "tool marker",
    }


def test_camera_and_log_are_there(recorded: Path) -> None:
    (camera,) = decoded(recorded, CALIBRATION)
    assert (camera.width, camera.height, camera.frame_id) == (1280, 720, CAMERA)
    assert (camera.K[0], camera.P[0]) == (SCENE_CONFIG.camera.lens.fx_px,) * 2
    assert [line.message for line in decoded(recorded, LOG)] == ["fault 1 began: supply_lost"]


@needs_rerun
def test_rerun_finds_every_topic(recorded: Path, tmp_path: Path) -> None:
    told = rerun(tmp_path, "mcap", "check", recorded)
    assert "error" not in told.lower()
    assert all(topic.name in told for topic in TOPICS if topic.name not in (CAPTURE, EVENT))
