"""The nominal arm as a tree of joints, and that tree as URDF."""

import math
from typing import NamedTuple
from xml.etree import ElementTree as etree

import numpy as np
from numpy.typing import ArrayLike

from nominal_arm.description import NominalArm
from nominal_arm.dimensions import dh_links, joint_turn, link_behind_joint
from plant_emulator.core.mechanics.bodies import NOTHING, Lump
from vision_pc.core.se3 import Array


class TreeJoint(NamedTuple):
    """One joint and the link behind it; joints follow each other, the first stands on the base B.

    ``X_PJ`` (4, 4) is the joint's frame at angle zero in the frame of the link before, ``axis`` (3,) lies in
    the joint's frame, in which ``body`` is given too (mass 0: none is known). ``limits`` rad, ``speed``
    rad/s and ``effort`` N m.
    """

    name: str
    X_PJ: Array
    axis: Array
    limits: tuple[float, float]
    speed: float
    effort: float = 1e9  # URDF asks for one, also where nobody knows it
    body: Lump = NOTHING


class TreeFrame(NamedTuple):
    """A frame called ``name`` on a link or frame called ``parent``; ``X_PF`` (4, 4): its pose in that."""

    name: str
    parent: str
    X_PF: Array


class ArmTree(NamedTuple):
    """An arm: ``X_LT`` (4, 4) is the tool centre point T in the last link.

    ``about`` says in words what the arm is, and what of it is left out. ``frames``: what else it carries.
    """

    name: str
    joints: tuple[TreeJoint, ...]
    X_LT: Array
    about: str
    frames: tuple[TreeFrame, ...] = ()


def nominal_tree(arm: NominalArm) -> ArmTree:
    """The six joints of ``arm``: kinematics alone, since a nominal arm has neither masses nor gravity.

    The joint of row i turns about z of the frame that row i − 1 ends in, turned by the row's own offset.
    """
    links, found, before = dh_links(arm), [], np.eye(4)
    for link, joint in zip(links, arm.joints, strict=False):
        limits = math.radians(joint.lower_deg), math.radians(joint.upper_deg)
        placed = before @ joint_turn(link.theta_offset)
        axis, speed = np.array([0.0, 0.0, 1.0]), math.radians(joint.speed_deg_s)
        found.append(TreeJoint(joint.name, placed, axis, limits, speed))
        before = link_behind_joint(link)
    mock = links[-1]
    tool = before @ joint_turn(mock.theta_offset) @ link_behind_joint(mock)
    about = "The nominal arm, as controller and vision believe it: kinematics, without masses."
    return ArmTree(arm.name, tuple(found), tool, about)


BASE = "base"  # name of the root link
TOOL = "tool"  # name of the link of the tool centre point
RADIUS_M = 0.06  # of the rods that viewers show; no number of the machine
_SHORTEST_M = 0.02  # a rod shorter than this is not drawn
_TOPICS = {
    "joint_commands_topic": "/longreach/joint_commands",
    "joint_states_topic": "/joint_states",
    "trigger_joint_command_threshold": "-1",  # every command, also one that holds: silence is a fault here
}
_INTERFACES = (("command", "position"), ("command", "velocity"), ("state", "position"))
# For MuJoCo's reader, which would else melt the tool into the last link and refuse links without mass.
# The least mass (kg) and inertia (kg m²) are nothing beside the lightest body, and enough to be read.
_FOR_MUJOCO = {
    "fusestatic": "false", "discardvisual": "false", "balanceinertia": "false", "inertiafromgeom": "false",
    "boundmass": "1e-09", "boundinertia": "1e-09",
}  # fmt: skip


def urdf(tree: ArmTree) -> str:
    """The URDF document of ``tree``: root link ``base`` is B, link ``tool`` is T, links are named as joints.

    Agrees with the arm's kinematics to rounding. SI units and radians.
    """
    robot = etree.Element("robot", name=tree.name)
    robot.append(etree.Comment(f" {tree.about} "))
    etree.SubElement(etree.SubElement(robot, "mujoco"), "compiler", _FOR_MUJOCO)
    etree.SubElement(robot, "link", name=BASE)
    parent, ends = BASE, [*(joint.X_PJ for joint in tree.joints[1:]), tree.X_LT]
    for joint, X_end in zip(tree.joints, ends, strict=True):
        child = f"{joint.name}_link"
        link = etree.SubElement(robot, "link", name=child)
        if joint.body.mass > 0.0:
            _add_inertial(link, joint.body)
        if np.linalg.norm(X_end[:3, 3]) > _SHORTEST_M:
            _add_rod(link, X_end[:3, 3])
        turning = _add_joint(robot, joint.name, "revolute", joint.X_PJ, (parent, child))
        etree.SubElement(turning, "axis", xyz=numbers(joint.axis))
        lower, upper, effort, speed = map(repr, (*joint.limits, float(joint.effort), joint.speed))
        etree.SubElement(turning, "limit", lower=lower, upper=upper, effort=effort, velocity=speed)
        parent = child
    for frame in (TreeFrame(TOOL, parent, tree.X_LT), *tree.frames):
        etree.SubElement(robot, "link", name=frame.name)
        _add_joint(robot, f"{frame.name}_mount", "fixed", frame.X_PF, (frame.parent, frame.name))
    _add_ros2_control(robot, tree)
    etree.indent(robot)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + etree.tostring(robot, encoding="unicode") + "\n"


def _add_ros2_control(robot: etree.Element, tree: ArmTree) -> None:
    """The block by which ros2_control drives the arm over topics (docs/ros2.md)."""
    system = etree.SubElement(robot, "ros2_control", name=tree.name, type="system")
    hardware = etree.SubElement(system, "hardware")
    etree.SubElement(hardware, "plugin").text = "joint_state_topic_hardware_interface/JointStateTopicSystem"
    for name, value in _TOPICS.items():
        etree.SubElement(hardware, "param", name=name).text = value
    for joint in tree.joints:
        element = etree.SubElement(system, "joint", name=joint.name)
        for kind, interface in _INTERFACES:
            etree.SubElement(element, f"{kind}_interface", name=interface)


def numbers(values: ArrayLike) -> str:
    """The values in a row, each with all its digits; a negative zero loses its sign."""
    return " ".join(repr(float(value) + 0.0) for value in np.ravel(np.asarray(values)))


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


def _add_joint(robot: etree.Element, name: str, kind: str, X: Array, links: tuple[str, str]) -> etree.Element:
    """The joint, at ``X`` (4, 4) in the first of ``links``, that carries the second."""
    joint = etree.SubElement(robot, "joint", name=name, type=kind)
    etree.SubElement(joint, "origin", xyz=numbers(X[:3, 3]), rpy=numbers(roll_pitch_yaw(X[:3, :3])))
    etree.SubElement(joint, "parent", link=links[0])
    etree.SubElement(joint, "child", link=links[1])
    return joint


def _add_inertial(link: etree.Element, body: Lump) -> None:
    inertial = etree.SubElement(link, "inertial")
    etree.SubElement(inertial, "origin", xyz=numbers(body.centre), rpy="0 0 0")
    etree.SubElement(inertial, "mass", value=repr(body.mass))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    etree.SubElement(inertial, "inertia", {key: repr(float(body.inertia[at])) for key, at in places.items()})


def _add_rod(link: etree.Element, end: Array) -> None:
    """A cylinder from the link's origin to ``end``, to be seen; it collides, with a ball at either end."""
    length, radius = repr(float(np.linalg.norm(end))), repr(RADIUS_M)
    turned = (0.0, math.atan2(math.hypot(end[0], end[1]), end[2]), math.atan2(end[1], end[0]))
    cylinder = ("cylinder", 0.5 * end, {"radius": radius, "length": length})
    balls = [("sphere", place, {"radius": radius}) for place in (np.zeros(3), end)]
    for kind, (form, place, size) in [("visual", cylinder), *(("collision", s) for s in (cylinder, *balls))]:
        shape = etree.SubElement(link, kind)
        etree.SubElement(shape, "origin", xyz=numbers(place), rpy=numbers(turned))
        etree.SubElement(etree.SubElement(shape, "geometry"), form, size)
