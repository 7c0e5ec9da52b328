"""What planners want of the nominal arm beside its kinematics: frames, efforts, masses, SRDF."""

from collections.abc import Iterator
from itertools import combinations
from xml.etree import ElementTree as etree

import numpy as np

from nominal_arm.description import CylinderDrive, JointConfig, NominalArm, RotaryDrive
from nominal_arm.dimensions import joint_turn
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.camera.scene import object_pose
from plant_emulator.core.mechanics.bodies import Lump, together
from plant_emulator.core.model import build_model
from plant_emulator.core.plant import NOMINAL_MOUNTS
from testbed.exports.arm_tree import BASE, RADIUS_M, TOOL, ArmTree, TreeFrame, document, rod_end
from testbed.scenarios.scenario import Settings
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.se3 import Array, inverse, transform
from vision_pc.shell.recording.vision_pictures import CAMERA_FRAMES

GROUP, HOME = "arm", "home"
_PA_PER_BAR = 1e5
_SAMPLES = 2000  # [D] poses at which two rods must be apart, or touch, for their pair to be left out
_ANGLES = 1001  # over a joint's range, in which its cylinder's greatest lever is looked for


def for_planning(tree: ArmTree, settings: Settings) -> ArmTree:
    """``tree``, nominal, with efforts, camera, marker and object frames, and rods that collide.

    Efforts (N m): of the emulated machine's pistons at the arm's rated pressures, at a cylinder's longest
    lever. Camera and marker sit as on the drawings, the object hangs where scene.yaml has it.
    """
    arm = settings.arm
    rated_pa = _PA_PER_BAR * (arm.rated.supply_bar - arm.rated.return_bar)
    efforts = [
        rated_pa * max(getattr(settings.plant.actuators, drive.name).areas()) * _lever(drive, joint)
        for drive, joint in zip(arm.drives, arm.joints, strict=True)
    ]
    joints = [one._replace(effort=effort) for one, effort in zip(tree.joints, efforts, strict=True)]
    return tree._replace(joints=tuple(joints), frames=tuple(_frames(settings)), collides=True)


def with_masses(tree: ArmTree, arm: NominalArm, plant: PlantConfig) -> ArmTree:
    """``tree``, nominal, with the masses of plant.yaml's parts, hung stiffly on the nominal joints.

    Without the machine's errors, hinges and payload: what drawings and data sheets say, not what is true.
    """
    off = {"enabled": False}
    errors = {
        name: getattr(plant.errors, name).model_copy(update=off) for name in type(plant.errors).model_fields
    }
    stiff = {
        "errors": plant.errors.model_copy(update=errors),
        "flexibility": plant.flexibility.model_copy(update=off),
    }
    model, chain, _ = build_model(plant.model_copy(update=stiff))
    mechanism, X_BL, joints = model.mechanism, np.eye(4), []
    lumps = [Lump(*one) for one in zip(mechanism.mass, mechanism.centre, mechanism.inertia, strict=True)]
    starts = [chain.names.index(joint.name) for joint in tree.joints]
    for joint, first, behind in zip(tree.joints, starts, [*starts[1:], len(lumps)], strict=True):
        X_BL = X_BL @ joint.X_PJ
        X_LB, whole = inverse(X_BL), together(lumps[first:behind])  # with what lies behind locked hinges
        centre = X_LB[:3, :3] @ whole.centre + X_LB[:3, 3]
        body = Lump(float(whole.mass), centre, X_LB[:3, :3] @ whole.inertia @ X_LB[:3, :3].T)
        joints.append(joint._replace(body=body))
    about = "The nominal arm with the masses of its parts by drawing and data sheet; stiff, without payload."
    return tree._replace(joints=tuple(joints), gravity=mechanism.gravity, about=about)


def srdf(tree: ArmTree, home: tuple[float, ...], seed: int = 1) -> str:
    """The SRDF document for MoveIt: group ``arm`` from base to tool, state ``home`` (rad), pairs left out.

    A pair of links is left out where its rods follow each other, and where none of many drawn poses, or
    every one, brings them together.
    """
    robot = etree.Element("robot", name=tree.name)
    group = etree.SubElement(robot, "group", name=GROUP)
    etree.SubElement(group, "chain", base_link=BASE, tip_link=TOOL)
    state = etree.SubElement(robot, "group_state", name=HOME, group=GROUP)
    for joint, angle in zip(tree.joints, home, strict=True):
        etree.SubElement(state, "joint", name=joint.name, value=repr(angle))
    for first, second, reason in pairs_left_out(tree, seed):
        names = {"link1": f"{tree.joints[first].name}_link", "link2": f"{tree.joints[second].name}_link"}
        etree.SubElement(robot, "disable_collisions", names | {"reason": reason})
    return document(robot, tree)


def pairs_left_out(tree: ArmTree, seed: int) -> list[tuple[int, int, str]]:
    """Pairs of rods that are not to be checked, by the numbers of their joints, each with MoveIt's reason."""
    rods = [i for i in range(len(tree.joints)) if rod_end(tree, i) is not None]
    limits = np.array([joint.limits for joint in tree.joints])
    drawn = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (_SAMPLES, len(limits)))
    near = np.array([[_near(*pair) for pair in combinations(_ends(tree, q, rods), 2)] for q in drawn])
    found = []
    for number, (first, second) in enumerate(combinations(rods, 2)):
        if rods.index(second) == rods.index(first) + 1:
            found.append((first, second, "Adjacent"))
        elif near[:, number].all() or not near[:, number].any():
            found.append((first, second, "Always" if near[0, number] else "Never"))
    return found


def _frames(settings: Settings) -> Iterator[TreeFrame]:
    camera = calibration(settings.vision.camera)
    left, right = CAMERA_FRAMES
    yield TreeFrame(left, TOOL, NOMINAL_MOUNTS.X_TC)
    yield TreeFrame(right, left, camera.right.X_CE)
    yield TreeFrame("tool_marker", TOOL, NOMINAL_MOUNTS.X_TM)
    yield TreeFrame("object", BASE, object_pose(settings.scene.object_of_interest))
    for marker in settings.vision.markers.object:
        X_OM = transform(np.eye(3), np.array([marker.x_m, marker.y_m, 0.0]))
        yield TreeFrame(f"object_marker_{marker.id}", "object", X_OM)


def _lever(drive: RotaryDrive | CylinderDrive, joint: JointConfig) -> float:
    """The greatest |dx/dq| of a cylinder over the joint's range, m; 1 of a rotary drive, by m³/rad."""
    if isinstance(drive, RotaryDrive):
        return 1.0
    q = np.radians(np.linspace(joint.lower_deg, joint.upper_deg, _ANGLES)) + drive.angle_offset_rad
    product = drive.long_m * drive.short_m
    length = np.sqrt(drive.long_m**2 + drive.short_m**2 + 2.0 * product * np.cos(q))
    return float(np.max(np.abs(product * np.sin(q) / length)))


def _ends(tree: ArmTree, q: Array, rods: list[int]) -> list[Array]:
    """Both ends (2, 3) in B of each rod."""
    X, found = np.eye(4), []
    for i, (joint, angle) in enumerate(zip(tree.joints, q, strict=True)):
        X = X @ joint.X_PJ @ joint_turn(angle)
        end = rod_end(tree, i)
        if i in rods and end is not None:
            found.append(np.array([X[:3, 3], X[:3, :3] @ end + X[:3, 3]]))
    return found


def _near(first: Array, second: Array) -> bool:
    """Whether two rods touch: segments (2, 3) within twice their radius (Ericson 2005, 5.1.9)."""
    d1, d2, r = first[1] - first[0], second[1] - second[0], first[0] - second[0]
    a, e, f, c, b = d1 @ d1, d2 @ d2, d2 @ r, d1 @ r, d1 @ d2
    denominator = a * e - b * b
    s = min(1.0, max(0.0, (b * f - c * e) / denominator)) if denominator > 0.0 else 0.0
    t = (b * s + f) / e
    if not 0.0 <= t <= 1.0:
        t = min(1.0, max(0.0, t))
        s = min(1.0, max(0.0, (b * t - c) / a))
    return bool(np.linalg.norm(r + s * d1 - t * d2) <= 2.0 * RADIUS_M)
