"""`longreach export`: the arm as a file that other tools read."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from xml.etree import ElementTree as etree

import numpy as np
import typer

from plant_emulator.core.mechanics.bodies import Lump
from protocol.errors import ConfigurationError
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile, Settings
from testbed.exports.arm_tree import RADIUS_M, TOOL, ArmTree, TreeJoint, document, numbers, rod_end
from testbed.reporting.console import out, writable, write_json
from vision_pc.core.se3 import Array, inverse, quaternion_from_rotation

if TYPE_CHECKING:
    from testbed.exports.arm_tree import ArmTree


BASE = "base"
_UNLIMITED = (
    1e9  # N m and rad/s: URDF asks for both of every joint; the oil's pressure limits them, not the joint
)
# For MuJoCo's reader, which would else melt the tool into the last link and refuse links without mass.
_FOR_MUJOCO = {"fusestatic": "false", "discardvisual": "false", "balanceinertia": "false"}
_LEAST_MASS, _LEAST_INERTIA = 1e-9, 1e-9  # kg, kg m²: nothing beside the lightest body, enough to be read


def urdf(tree: ArmTree) -> str:
    """The URDF document of ``tree``: root link ``base`` is B, link ``tool`` is T, links are named as joints.

    Agrees with the arm's kinematics to rounding. SI units and radians.
    """
    robot = etree.Element("robot", name=tree.name)
    bounds = {"boundmass": repr(_LEAST_MASS), "boundinertia": repr(_LEAST_INERTIA)}
    etree.SubElement(etree.SubElement(robot, "mujoco"), "compiler", _FOR_MUJOCO | bounds)
    etree.SubElement(robot, "link", name=BASE)
    before = BASE
    for i, joint in enumerate(tree.joints):
        link = etree.SubElement(robot, "link", name=f"{joint.name}_link")
        if joint.body.mass > 0.0:
            _add_inertial(link, joint.body)
        end = rod_end(tree, i)
        if end is not None:
            _add_rod(link, end)
        _add_joint(robot, joint, before)
        before = f"{joint.name}_link"
    etree.SubElement(robot, "link", name=TOOL)
    fixed = etree.SubElement(robot, "joint", name="tool_mount", type="fixed")
    _add_place(fixed, tree.X_LT, before, TOOL)
    return document(robot, tree)


def roll_pitch_yaw(rotation: Array) -> tuple[float, float, float]:
    """Angles with Rz(yaw) Ry(pitch) Rx(roll) = ``rotation`` (3, 3), to rounding also at gimbal lock.

    Yaw first; then pitch and roll are of what Rz(−yaw) leaves, whatever yaw came out of a vanishing cosine.
    """
    R = rotation
    yaw = math.atan2(R[1, 0], R[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll, pitch, yaw


def _add_joint(robot: etree.Element, joint: TreeJoint, parent: str) -> None:
    kind = "fixed" if joint.locked else "revolute"
    element = etree.SubElement(robot, "joint", name=joint.name, type=kind)
    _add_place(element, joint.X_PJ, parent, f"{joint.name}_link")
    if joint.locked:
        return
    etree.SubElement(element, "axis", xyz=numbers(joint.axis))
    lower, upper = map(repr, joint.limits)
    speed = repr(_UNLIMITED if joint.speed is None else joint.speed)
    etree.SubElement(element, "limit", lower=lower, upper=upper, effort=repr(_UNLIMITED), velocity=speed)
    if joint.damping > 0.0:
        etree.SubElement(element, "dynamics", damping=repr(joint.damping))


def _add_place(joint: etree.Element, X: Array, parent: str, child: str) -> None:
    etree.SubElement(joint, "origin", xyz=numbers(X[:3, 3]), rpy=numbers(roll_pitch_yaw(X[:3, :3])))
    etree.SubElement(joint, "parent", link=parent)
    etree.SubElement(joint, "child", link=child)


def _add_inertial(link: etree.Element, body: Lump) -> None:
    inertial = etree.SubElement(link, "inertial")
    etree.SubElement(inertial, "origin", xyz=numbers(body.centre), rpy="0 0 0")
    etree.SubElement(inertial, "mass", value=repr(body.mass))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    etree.SubElement(inertial, "inertia", {key: repr(float(body.inertia[at])) for key, at in places.items()})


def _add_rod(link: etree.Element, end: Array) -> None:
    """A cylinder from the link's origin to ``end``."""
    x, y, z = (float(value) for value in end)
    visual = etree.SubElement(link, "visual")
    turned = (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))
    etree.SubElement(visual, "origin", xyz=numbers(0.5 * end), rpy=numbers(turned))
    geometry = etree.SubElement(visual, "geometry")
    etree.SubElement(geometry, "cylinder", radius=repr(RADIUS_M), length=repr(math.hypot(x, y, z)))


_LEAST = 1e-9  # kg, kg m²: of the bodies of an arm without masses, which MuJoCo does not read


def mjcf(tree: ArmTree) -> str:
    """The MJCF document of ``tree``: the world is B, body ``tool`` is T, joints have the arm's names.

    Where the tree has masses, a link without one is a joint more on the next body, as MuJoCo wants it.
    """
    root = etree.Element("mujoco", model=tree.name)
    weighed = any(joint.body.mass > 0.0 for joint in tree.joints)
    compiler = {"angle": "radian", "balanceinertia": "false", "autolimits": "true"}
    if not weighed:
        compiler |= {"boundmass": repr(_LEAST), "boundinertia": repr(_LEAST)}
    etree.SubElement(root, "compiler", compiler)
    option = etree.SubElement(root, "option", gravity=numbers(tree.gravity))
    etree.SubElement(option, "flag", contact="disable")
    inside = etree.SubElement(root, "worldbody")
    frame: Array = np.eye(4)
    waiting: list[tuple[TreeJoint, Array]] = []
    for i, joint in enumerate(tree.joints):
        frame = frame @ joint.X_PJ
        waiting.append((joint, frame))
        if weighed and joint.body.mass == 0.0:
            continue
        inside = _add_body(inside, waiting)
        end = rod_end(tree, i)
        if end is not None:
            _add_mjcf_rod(inside, end)
        frame, waiting = np.eye(4), []
    tool = etree.SubElement(inside, "body", {"name": TOOL} | _place(tree.X_LT))
    etree.SubElement(tool, "site", name="tcp", size="0.02")
    return document(root, tree)


def _add_body(parent: etree.Element, joints: list[tuple[TreeJoint, Array]]) -> etree.Element:
    """A body with these joints, outer first; each comes with its frame in the parent's body."""
    last, X_PL = joints[-1]
    body = etree.SubElement(parent, "body", {"name": f"{last.name}_link"} | _place(X_PL))
    X_LP = inverse(X_PL)
    for joint, X_PJ in joints:
        if not joint.locked:
            _add_hinge(body, joint, X_LP @ X_PJ)
    lump = last.body
    if lump.mass > 0.0:
        entries = lump.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        told = {"pos": numbers(lump.centre), "mass": repr(lump.mass), "fullinertia": numbers(entries)}
        etree.SubElement(body, "inertial", told)
    return body


def _add_hinge(body: etree.Element, joint: TreeJoint, X_LJ: Array) -> None:
    """A hinge at ``X_LJ`` in the body's frame."""
    told = {"name": joint.name, "type": "hinge", "range": numbers(joint.limits)}
    told |= {"pos": numbers(X_LJ[:3, 3]), "axis": numbers(X_LJ[:3, :3] @ joint.axis)}
    if joint.stiffness > 0.0:
        told |= {"stiffness": repr(joint.stiffness), "damping": repr(joint.damping)}
    etree.SubElement(body, "joint", told)


def _add_mjcf_rod(body: etree.Element, end: Array) -> None:
    """A capsule from the body's origin to ``end``: to be seen, without mass or contact."""
    told = {"type": "capsule", "fromto": f"0 0 0 {numbers(end)}", "size": repr(RADIUS_M), "mass": "0"}
    etree.SubElement(body, "geom", told | {"contype": "0", "conaffinity": "0"})


def _place(X: Array) -> dict[str, str]:
    return {"pos": numbers(X[:3, 3]), "quat": numbers(quaternion_from_rotation(X[:3, :3]))}


app = typer.Typer(help="The arm as a file for other tools.", no_args_is_help=True)

Target = Annotated[Path, typer.Option("--out", help="Where the file goes.", callback=writable)]
TrueArm = Annotated[
    bool,
    typer.Option("--true", help="The plant's own arm, with hinges and masses, instead of the nominal one."),
]


@app.command("urdf", epilog="Example: longreach export urdf --out arm.urdf")
def urdf_command(
    file: Target,
    true: TrueArm = False,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """The arm as URDF, for ROS, Pinocchio and viewers: links, joints, masses; no springs, no gravity."""
    from testbed.exports.command import urdf

    _write(urdf, _tree(config_dir, settings, true), file, json_file)


@app.command("mjcf", epilog="Example: longreach export mjcf --true --out arm.xml")
def mjcf_command(
    file: Target,
    true: TrueArm = False,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """The arm as MJCF, for MuJoCo; with --true also the springs and dampers of its hinges, and gravity."""
    from testbed.exports.command import mjcf

    _write(mjcf, _tree(config_dir, settings, true, springs=True), file, json_file)


def _tree(config_dir: Path, assignments: list[str] | None, true: bool, springs: bool = False) -> "ArmTree":
    """The arm that was asked for.

    Raises ConfigurationError (``export.inexpressible``) for ``springs`` of a true arm that has forces which
    are no springs of one joint.
    """
    from foundation.configuration import parse_overrides
    from testbed.exports.arm_tree import inexpressible, nominal_tree, true_tree
    from testbed.scenarios.scenario import load_settings

    chosen = load_settings(config_dir, parse_overrides(assignments or []))
    if not true:
        return nominal_tree(chosen.arm)
    left_out = inexpressible(chosen.plant) if springs else []
    if left_out:
        off = " ".join(f"--set {key}=false" for key in left_out)
        raise ConfigurationError(
            "export.inexpressible",
            f"{', '.join(left_out)}: MJCF has no form for these forces; export without them: {off}",
        )
    return true_tree(chosen.arm, chosen.plant)


def _write(form: "Callable[[ArmTree], str]", tree: "ArmTree", file: Path, json_file: Path | None) -> None:
    text = form(tree)
    file.write_text(text, encoding="utf-8")
    moving = [joint.name for joint in tree.joints if not joint.locked]
    mass_kg = sum(joint.body.mass for joint in tree.joints)
    weight = f"{mass_kg:.1f} kg" if mass_kg > 0.0 else "no masses"
    out.print(f"{file}: {tree.name}, {len(moving)} joints, {weight}", highlight=False, soft_wrap=True)
    write_json(json_file, {"file": file, "name": tree.name, "joints": moving, "mass_kg": mass_kg})
