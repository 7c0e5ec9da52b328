"""Exports for planners, as Pinocchio and MuJoCo read them: frames, shapes, masses, limits."""

from collections import Counter
from pathlib import Path
from xml.etree import ElementTree as etree

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from nominal_arm.description import JOINT_NAMES
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work
from plant_emulator.core.model import build_model
from testbed.exports.arm_tree import RADIUS_M, nominal_tree, urdf
from testbed.exports.planning import for_planning
from testbed.scenarios.scenario import Settings, load_settings
from tests.support.commands import ran
from tests.support.paths import CONFIGS, ROOT
from tests.testbed.exports.readers import STIFF, PinocchioReader
from vision_pc.core.se3 import Array, inverse


@pytest.fixture(scope="module")
def settings() -> Settings:
    return load_settings(CONFIGS, {})


def exported(folder: Path, *options: str) -> Path:
    file = folder / f"arm.{options[0]}"
    ran("export", *options, "--out", file, "--config-dir", CONFIGS)
    return file


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("urdf"), "urdf")


def frame(reader: PinocchioReader, q: Array, name: str) -> Array:
    reader.pose(q)
    return np.array(reader._data.oMf[reader.model.getFrameId(name)].homogeneous)


def test_camera_markers_and_object_are_frames_where_the_drawings_have_them(
    plain: Path, settings: Settings
) -> None:
    reader = PinocchioReader(plain)
    q = np.radians(settings.plant.start_pose_deg)
    X_BT = tool_pose(dh_table(settings.arm.dh), q)
    assert np.allclose(frame(reader, q, "tool"), X_BT, atol=1e-12)
    in_tool = inverse(X_BT) @ frame(reader, q, "camera_left_optical")
    assert np.allclose(in_tool[:3, 3], [-0.20, -0.05, -0.40], atol=1e-12)
    across = inverse(frame(reader, q, "camera_left_optical")) @ frame(reader, q, "camera_right_optical")
    assert np.allclose(across[:3, 3], [settings.vision.camera.calibration.baseline_m, 0.0, 0.0], atol=1e-12)
    X_CO = inverse(frame(reader, q, "camera_left_optical")) @ frame(reader, q, "object")
    assert X_CO[2, 3] > 0.5, "the object is before the camera"
    facing = inverse(X_BT) @ frame(reader, q, "tool_marker")
    assert np.allclose(facing[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    apart = frame(reader, q, "object_marker_2")[:3, 3] - frame(reader, q, "object_marker_1")[:3, 3]
    assert np.linalg.norm(apart) == pytest.approx(0.4)


def test_limits_are_the_drives_own(plain: Path, settings: Settings) -> None:
    model = PinocchioReader(plain).model
    speeds = np.radians([joint.speed_deg_s for joint in settings.arm.joints])
    assert np.allclose(model.velocityLimit, speeds)
    assert model.effortLimit[0] == pytest.approx(4.0e-4 * 180e5)
    bore = np.pi / 4 * 0.08**2 * 180e5
    levers = model.effortLimit[1:3] / bore
    assert np.all((levers > 0.25) & (levers < 0.38)), "a cylinder's lever is at most its crank"


def test_shapes_are_read(plain: Path) -> None:
    model = PinocchioReader(plain).model
    shapes = pin.buildGeomFromUrdf(model, str(plain), pin.GeometryType.COLLISION)
    kinds = Counter(type(one.geometry).__name__ for one in shapes.geometryObjects)
    rods = kinds["Cylinder"]
    assert rods >= 4
    assert kinds["Sphere"] == 2 * rods
    assert {one.geometry.radius for one in shapes.geometryObjects} == {RADIUS_M}


def test_masses_move_as_the_stiff_plant_does(settings: Settings, tmp_path: Path) -> None:
    model, chain, _ = build_model(load_settings(CONFIGS, STIFF).plant)
    driven = [chain.names.index(name) for name in JOINT_NAMES]
    reader = PinocchioReader(exported(tmp_path, "urdf", "--masses"))
    rng = np.random.default_rng(7)
    lower, upper = reader.model.lowerPositionLimit, reader.model.upperPositionLimit
    for q in rng.uniform(lower, upper, (20, 6)):
        moving = np.zeros((4, len(chain.names)))  # angles, rates, torques, accelerations
        moving[:3, driven] = q, rng.normal(0.0, 0.2, 6), rng.normal(0.0, 500.0, 6)
        forward_dynamics(*moving[:3], model.mechanism, multibody_work(len(chain.names)), moving[3])
        read = reader.acceleration(*moving[:3, driven], model.mechanism.gravity)
        np.testing.assert_allclose(read, moving[3, driven], rtol=1e-8, atol=1e-7)


def test_mujoco_reads_shapes_and_masses_and_lets_the_arm_fall(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(exported(tmp_path, "urdf", "--masses")))
    weighed = PinocchioReader(tmp_path / "arm.urdf").model
    # Pinocchio puts what the base carries into no joint; here every body hangs on one.
    assert float(model.body_mass.sum()) == pytest.approx(pin.computeTotalMass(weighed), rel=1e-6)
    assert (model.geom_contype > 0).sum() >= 12
    assert model.njnt == 6


def test_ros2_control_finds_every_joint_and_the_bridges_topics(settings: Settings) -> None:
    root = etree.fromstring(urdf(for_planning(nominal_tree(settings.arm), settings)).encode())
    block = root.find("ros2_control")
    assert [one.get("name") for one in block.findall("joint")] == list(JOINT_NAMES)
    said = {one.get("name"): one.text for one in block.iter("param")}
    assert said["trigger_joint_command_threshold"] == "-1", "a command that holds is sent too"
    source = (ROOT / "longreach_ros2" / "drive_node.py").read_text(encoding="utf-8")
    for key, place in (("joint_commands_topic", "~/joint_commands"), ("joint_states_topic", "joint_states")):
        assert f'"{place}"' in source
        assert said[key].endswith(place.removeprefix("~"))
