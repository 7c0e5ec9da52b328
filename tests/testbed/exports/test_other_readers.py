"""Exports as Drake, yourdfpy and urchin read them: shapes, masses and motion, not poses alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from nominal_arm.description import JOINT_NAMES
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work
from plant_emulator.core.model import build_model
from testbed.scenarios.scenario import Settings, load_settings
from tests.support.commands import ran
from tests.support.paths import CONFIGS
from tests.testbed.exports.readers import STIFF, MujocoReader, PinocchioReader
from vision_pc.core.se3 import Array

POSES = 20
SHAPES = 15  # five rods: a cylinder and two spheres each
INVENTED_KG = 1.0  # that urchin gives to a link without a mass


@pytest.fixture(scope="module")
def settings() -> Settings:
    return load_settings(CONFIGS, STIFF)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The nominal arm with masses."""
    folder = tmp_path_factory.mktemp("exports")
    ran("export", "urdf", "--masses", "--out", folder / "arm.urdf", "--config-dir", CONFIGS)
    return folder


def weight_kg(folder: Path) -> float:
    return float(MujocoReader(folder / "arm.urdf").model.body_mass.sum())


def drawn(folder: Path) -> Array:
    model = PinocchioReader(folder / "arm.urdf").model
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    return np.random.default_rng(11).uniform(lower, upper, (POSES, len(lower)))


@pytest.mark.slow("the first import of yourdfpy, with what it draws with")
def test_yourdfpy_validates_and_has_our_poses_shapes_and_masses(folder: Path, settings: Settings) -> None:
    yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is absent: make peers")
    read = yourdfpy.URDF.load(str(folder / "arm.urdf"))
    assert read.validate()
    assert tuple(read.actuated_joint_names) == JOINT_NAMES
    assert sum(len(link.collisions) for link in read.robot.links) == SHAPES
    masses = [link.inertial.mass for link in read.robot.links if link.inertial]
    assert sum(masses) == pytest.approx(weight_kg(folder), rel=1e-9)
    table = dh_table(settings.arm.dh)
    for q in drawn(folder):
        read.update_cfg(q)
        assert np.allclose(read.get_transform("tool", "base"), tool_pose(table, q), atol=1e-12)


def test_urchin_has_our_poses_and_shapes_and_masses_of_its_own_where_there_are_none(
    folder: Path, settings: Settings
) -> None:
    urchin = pytest.importorskip("urchin", reason="urchin is absent: make peers")
    read = urchin.URDF.load(str(folder / "arm.urdf"))
    assert sum(len(link.collisions) for link in read.links) == SHAPES
    said = (folder / "arm.urdf").read_text(encoding="utf-8")
    massless = len(read.links) - said.count("<inertial>")
    masses = sum(link.inertial.mass for link in read.links)
    assert masses == pytest.approx(weight_kg(folder) + INVENTED_KG * massless)
    table = dh_table(settings.arm.dh)
    for q in drawn(folder):
        found = read.link_fk(dict(zip(JOINT_NAMES, q, strict=True)), link="tool")
        assert np.allclose(found, tool_pose(table, q), atol=1e-12)


def drake_plant(file: Path) -> Any:
    """A plant of Drake with the arm of ``file``."""
    multibody = pytest.importorskip("pydrake.multibody.plant", reason="Drake is absent: make peers")
    plant = multibody.MultibodyPlant(0.0)
    parsing = pytest.importorskip("pydrake.multibody.parsing", reason="Drake is absent: make peers")
    parsing.Parser(plant).AddModels(str(file))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    return plant


def accelerations(plant: Any, moving: Array, names: list[str]) -> Array:
    """(n,) of the joints ``names``: ``moving`` has their angles and rates, (2, n)."""
    context = plant.CreateDefaultContext()
    for name, angle, rate in zip(names, *moving, strict=True):
        joint = plant.GetJointByName(name)
        joint.set_angle(context, angle)
        joint.set_angular_rate(context, rate)
    found = plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :]
    return np.array([found[plant.GetJointByName(name).velocity_start()] for name in names])


def test_drakes_arm_falls_as_the_stiff_plant_does(folder: Path, settings: Settings) -> None:
    model, chain, _ = build_model(settings.plant)
    plant = drake_plant(folder / "arm.urdf")
    plant.mutable_gravity_field().set_gravity_vector(model.mechanism.gravity)
    assert plant.CalcTotalMass(plant.CreateDefaultContext()) == pytest.approx(weight_kg(folder), rel=1e-9)
    driven = [chain.names.index(name) for name in JOINT_NAMES]
    rng = np.random.default_rng(7)
    for q in drawn(folder):
        angles, rates, torques, own = np.zeros((4, len(chain.names)))
        angles[driven], rates[driven] = q, rng.normal(0.0, 0.2, 6)
        forward_dynamics(angles, rates, torques, model.mechanism, multibody_work(len(own)), own)
        read = accelerations(plant, np.array([angles, rates])[:, driven], list(JOINT_NAMES))
        np.testing.assert_allclose(read, own[driven], rtol=1e-8, atol=1e-7)
