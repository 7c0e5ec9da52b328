"""Exported arms in two readers that share no line with ours: poses, masses, springs; and what is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from foundation.configuration import load
from nominal_arm.description import JOINT_NAMES, NominalArm
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.mechanics.geometry import build_chain
from plant_emulator.core.mechanics.multibody import forward_dynamics, forward_kinematics, multibody_work
from plant_emulator.core.model import build_model, put_payload
from testbed.cli.main import app
from testbed.exports.arm_tree import ArmTree, mjcf, nominal_tree, roll_pitch_yaw, true_tree, urdf
from tests.support.paths import CONFIGS
from tests.testbed.exports.readers import READERS, MujocoReader, PinocchioReader
from vision_pc.core.se3 import Array, exp_so3, transform

FORMS = {"urdf": urdf, "mjcf": mjcf}
ARMS = {"4 m arm": "", "10 m crane": "arms/long_crane/"}
POSES = 1000
ROUNDING = 1e-12  # of poses, m and 1; the readers' own rounding is 1e-14


def nominal(which: str) -> NominalArm:
    return load(NominalArm, CONFIGS / f"{ARMS[which]}arm.yaml")


def plant(which: str, **changes: object) -> PlantConfig:
    return load(PlantConfig, CONFIGS / f"{ARMS[which]}plant.yaml", changes)


def written(tree: ArmTree, form: str, folder: Path) -> Path:
    path = folder / f"arm.{form}"
    path.write_text(FORMS[form](tree), encoding="utf-8")
    return path


def drawn(tree: ArmTree, count: int, seed: int) -> Array:
    """Angles (count, n) between the limits of the joints that turn."""
    limits = np.array([joint.limits for joint in tree.joints if not joint.locked])
    return np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (count, len(limits)))


def greatest_difference(
    readers: list[Callable[[Array], Array]], own: Callable[[Array], Array], q: Array
) -> float:
    return max(float(np.abs(read(row) - own(row)).max()) for row in q for read in readers)


@pytest.mark.parametrize("which", ARMS)
@pytest.mark.parametrize("form", FORMS)
def test_the_nominal_arm_has_the_controllers_poses(which: str, form: str, tmp_path: Path) -> None:
    arm = nominal(which)
    tree, table = nominal_tree(arm), dh_table(arm.dh)
    path = written(tree, form, tmp_path)
    readers = [reader(path).pose for reader in READERS]
    assert MujocoReader(path).names == list(JOINT_NAMES)
    assert greatest_difference(readers, lambda q: tool_pose(table, q), drawn(tree, POSES, 1)) < ROUNDING


@pytest.mark.parametrize("which", ARMS)
@pytest.mark.parametrize("form", FORMS)
def test_the_true_arm_has_the_plants_poses_with_every_hinge(which: str, form: str, tmp_path: Path) -> None:
    config = plant(which)
    tree, chain = true_tree(nominal(which), config), build_chain(config)
    mechanism, work = build_model(config)[0].mechanism, multibody_work(len(chain.names))

    def own(q: Array) -> Array:
        forward_kinematics(q, mechanism, work)
        return transform(work.rotation[-1], work.origin[-1]) @ chain.X_BT_home

    path = written(tree, form, tmp_path)
    assert MujocoReader(path).names == list(chain.names)
    readers = [reader(path).pose for reader in READERS]
    assert greatest_difference(readers, own, drawn(tree, POSES, 2)) < ROUNDING


def own_accelerations(config: PlantConfig, q: Array, rate: Array) -> tuple[Array, Array]:
    """The plant's accelerations (n,) under springs, dampers and gravity, and the springs' torques."""
    model, chain, tool = build_model(config)
    put_payload(model, tool, config.payload.mass_kg, config, chain)
    mechanism, found = model.mechanism, np.zeros(len(q))
    springs = -mechanism.stiffness * q - mechanism.damping * rate
    forward_dynamics(q, rate, springs, mechanism, multibody_work(len(q)), found)
    return found, springs


@pytest.mark.parametrize("which", ARMS)
def test_masses_springs_and_gravity_arrive(which: str, tmp_path: Path) -> None:
    config = plant(which, payload={"mass_kg": 60.0}, errors={"pin_compliance": {"enabled": True}})
    tree = true_tree(nominal(which), config)
    physical = MujocoReader(written(tree, "mjcf", tmp_path))
    weighed = PinocchioReader(written(tree, "urdf", tmp_path))
    rng = np.random.default_rng(3)
    bent = np.array([1.0 if joint.name in JOINT_NAMES else 0.02 for joint in tree.joints])
    for q in bent * drawn(tree, 20, 3):
        rate = rng.normal(0.0, 0.2, len(q))
        own, springs = own_accelerations(config, q, rate)
        np.testing.assert_allclose(physical.acceleration(q, rate), own, rtol=1e-8, atol=1e-7)
        read = weighed.acceleration(q, rate, springs, tree.gravity)
        np.testing.assert_allclose(read, own, rtol=1e-8, atol=1e-7)


@pytest.mark.parametrize("form", FORMS)
def test_a_stiff_arm_has_six_joints(form: str, tmp_path: Path) -> None:
    config = plant("4 m arm", flexibility={"enabled": False})
    tree = true_tree(nominal("4 m arm"), config)
    path = written(tree, form, tmp_path)
    assert MujocoReader(path).names == list(JOINT_NAMES)
    model, chain, _ = build_model(config)
    work = multibody_work(len(chain.names))
    for q in drawn(tree, 20, 4):
        bent = np.zeros(len(chain.names))
        bent[[chain.names.index(name) for name in JOINT_NAMES]] = q
        forward_kinematics(bent, model.mechanism, work)
        own = transform(work.rotation[-1], work.origin[-1]) @ chain.X_BT_home
        for reader in READERS:
            np.testing.assert_allclose(reader(path).pose(q), own, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("pitch", [0.0, 0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9])
def test_roll_pitch_and_yaw_give_the_rotation_back_also_at_gimbal_lock(pitch: float) -> None:
    for roll, yaw in np.random.default_rng(5).uniform(-3.0, 3.0, (50, 2)):
        x, y, z = (exp_so3(np.eye(3)[i] * angle) for i, angle in enumerate((roll, pitch, yaw)))
        r, p, w = roll_pitch_yaw(z @ y @ x)
        again = exp_so3([0.0, 0.0, w]) @ exp_so3([0.0, p, 0.0]) @ exp_so3([r, 0.0, 0.0])
        np.testing.assert_allclose(again, z @ y @ x, rtol=0.0, atol=4e-15)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["export", *arguments, "--config-dir", str(CONFIGS)])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ("mjcf", "--true", "--set", "plant.errors.loose_slew.enabled=true"),
            "export.inexpressible: plant.errors.loose_slew.enabled",
        ),
        (("urdf", "--set", "arm.dh=3"), "arm.yaml: dh = 3"),
        (("urdf", "--set", "crane.dh=3"), "configuration.unknown_file"),
    ],
)
def test_what_cannot_be_exported_is_refused_by_name(
    arguments: tuple[str, ...], told: str, tmp_path: Path
) -> None:
    file = tmp_path / "arm"
    done = run(*arguments, "--out", str(file))
    assert done.exit_code == 2
    assert told in done.stderr
    assert not file.exists()


def test_a_play_is_a_joint_in_urdf_which_has_no_forces(tmp_path: Path) -> None:
    done = run(
        "urdf", "--true", "--set", "plant.errors.loose_slew.enabled=true", "--out", str(tmp_path / "a.urdf")
    )
    assert done.exit_code == 0, done.output
    assert "slew_play" in MujocoReader(tmp_path / "a.urdf").names
