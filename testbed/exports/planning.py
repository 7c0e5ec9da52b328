"""What planners want of the nominal arm beside its kinematics: frames, efforts, masses."""

from collections.abc import Iterator

import numpy as np

from nominal_arm.description import CylinderDrive, JointConfig, NominalArm, RotaryDrive
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.camera.scene import object_pose
from plant_emulator.core.mechanics.bodies import Lump, together
from plant_emulator.core.model import build_model
from plant_emulator.core.plant import NOMINAL_MOUNTS
from testbed.exports.arm_tree import BASE, TOOL, ArmTree, TreeFrame
from testbed.scenarios.scenario import Settings
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.se3 import inverse, transform
from vision_pc.shell.recording.vision_pictures import CAMERA_FRAMES

_PA_PER_BAR = 1e5
_ANGLES = 1001  # over a joint's range, in which its cylinder's greatest lever is looked for


def for_planning(tree: ArmTree, settings: Settings) -> ArmTree:
    """``tree``, nominal, with efforts and the frames of camera, markers and object.

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
    return tree._replace(joints=tuple(joints), frames=tuple(_frames(settings)))


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
    return tree._replace(joints=tuple(joints), about=about)


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
