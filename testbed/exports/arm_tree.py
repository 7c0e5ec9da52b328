"""The arm as a tree of joints, and that tree as URDF and as MJCF."""

import math
from typing import NamedTuple
from xml.etree import ElementTree as etree

import numpy as np
from numpy.typing import ArrayLike

from nominal_arm.description import JOINT_NAMES, JointConfig, NominalArm
from nominal_arm.dimensions import dh_links, joint_turn, link_behind_joint
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.mechanics.bodies import NOTHING, Lump
from plant_emulator.core.mechanics.geometry import transform
from plant_emulator.core.model import Model, build_model, put_payload
from vision_pc.core.se3 import Array, inverse, quaternion_from_rotation

HINGE_RANGE_RAD = (
    0.5  # either way, told of a hinge: far more than any boom bends, so that a viewer has an end
)


class TreeJoint(NamedTuple):
    """One joint and the link behind it; joints follow each other, the first stands on the base B.

    ``X_PJ`` (4, 4) is the joint's frame at angle zero in the frame of the link before, ``axis`` (3,) lies in
    the joint's frame, in which ``body`` is given too (mass 0: none is known). ``limits`` rad, ``speed``
    rad/s and ``effort`` N m (None: not known), ``stiffness`` N m/rad, ``damping`` N m s/rad. ``locked``: it
    does not turn.
    """

    name: str
    X_PJ: Array
    axis: Array
    limits: tuple[float, float]
    speed: float | None = None
    effort: float | None = None
    stiffness: float = 0.0
    damping: float = 0.0
    body: Lump = NOTHING
    locked: bool = False


class TreeFrame(NamedTuple):
    """A frame called ``name`` on a link or frame called ``parent``; ``X_PF`` (4, 4): its pose in that."""

    name: str
    parent: str
    X_PF: Array


class ArmTree(NamedTuple):
    """An arm: ``X_LT`` (4, 4) is the tool centre point T in the last link, ``gravity`` (3,) m/s² in B.

    ``about`` says in words what the arm is, and what of it is left out. ``frames``: what else it carries;
    ``collides``: its rods may not touch; both of URDF alone.
    """

    name: str
    joints: tuple[TreeJoint, ...]
    X_LT: Array
    gravity: Array
    about: str
    frames: tuple[TreeFrame, ...] = ()
    collides: bool = False


def nominal_tree(arm: NominalArm) -> ArmTree:
    """The six joints of ``arm``: kinematics alone, since a nominal arm has neither masses nor gravity.

    The joint of row i turns about z of the frame that row i − 1 ends in, turned by the row's own offset.
    """
    links, found, before = dh_links(arm), [], np.eye(4)
    for link, joint in zip(links, arm.joints, strict=False):
        found.append(
            TreeJoint(
                joint.name,
                before @ joint_turn(link.theta_offset),
                np.array([0.0, 0.0, 1.0]),
                _limits(joint),
                math.radians(joint.speed_deg_s),
            )
        )
        before = link_behind_joint(link)
    mock = links[-1]
    tool = before @ joint_turn(mock.theta_offset) @ link_behind_joint(mock)
    about = "The nominal arm, as controller and vision believe it: kinematics, without masses."
    return ArmTree(arm.name, tuple(found), tool, np.zeros(3), about)


def true_tree(arm: NominalArm, config: PlantConfig) -> ArmTree:
    """The plant's own arm with every hinge in which it bends, its masses, payload, springs and damping.

    At zero every link's frame is turned as B is, so that the joints' axes are the plant's own numbers.
    ``arm`` gives the range of the six driven joints. ``inexpressible`` says what a tree cannot hold.
    """
    model, chain, bare_tool = build_model(config)
    put_payload(model, bare_tool, config.payload.mass_kg, config, chain)
    found, before = [], np.zeros(3)
    for i, name in enumerate(chain.names):
        point = chain.point[i]
        found.append(_true_joint(model, i, name, arm)._replace(X_PJ=transform(np.eye(3), point - before)))
        before = point
    tool = transform(np.eye(3), -before) @ chain.X_BT_home
    about = (
        "The true arm of the plant with its hinges, masses and payload. Of the drives there is nothing: "
        "no oil, no friction, no end stops, no play between encoder and load."
    )
    return ArmTree(f"{arm.name}-true", tuple(found), tool, model.mechanism.gravity, about)


def inexpressible(config: PlantConfig) -> list[str]:
    """The keys of plant.yaml that are on and whose forces are no spring and damper of one joint."""
    errors = config.errors
    effects = {
        "loose_slew": errors.loose_slew.enabled,
        "bearing_tilt": errors.bearing_tilt.enabled,
        "finer_bending": errors.finer_bending.enabled,
        "vibration": errors.vibration.enabled,
    }
    return [f"plant.errors.{name}.enabled" for name, enabled in effects.items() if enabled]


def _true_joint(model: Model, i: int, name: str, arm: NominalArm) -> TreeJoint:
    """Coordinate ``i`` of the chain; its place is put in by the caller."""
    mechanism = model.mechanism
    body = Lump(float(mechanism.mass[i]), mechanism.centre[i] - mechanism.point[i], mechanism.inertia[i])
    limits, speed = (-HINGE_RANGE_RAD, HINGE_RANGE_RAD), None
    if name in JOINT_NAMES:
        joint = arm.joints[JOINT_NAMES.index(name)]
        limits, speed = _limits(joint), math.radians(joint.speed_deg_s)
    return TreeJoint(
        name,
        np.eye(4),
        mechanism.axis[i],
        limits,
        speed,
        stiffness=float(mechanism.stiffness[i]),
        damping=float(mechanism.damping[i]),
        body=body if body.mass > 0.0 else NOTHING,
        locked=mechanism.free[i] == 0.0,
    )


def _limits(joint: JointConfig) -> tuple[float, float]:
    return math.radians(joint.lower_deg), math.radians(joint.upper_deg)


TOOL = "tool"  # name of the link or body of the tool centre point
RADIUS_M = 0.06  # of the rods that viewers show; no number of the machine
_SHORTEST_M = 0.02  # a rod shorter than this is not drawn


def numbers(values: ArrayLike) -> str:
    """The values in a row, each with all its digits; a negative zero loses its sign."""
    return " ".join(repr(float(value) + 0.0) for value in np.ravel(np.asarray(values)))


def document(root: etree.Element, tree: ArmTree) -> str:
    """The indented document, with what the arm is in a comment at its head."""
    root.insert(0, etree.Comment(f" {tree.about} "))
    etree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + etree.tostring(root, encoding="unicode") + "\n"


def rod_end(tree: ArmTree, index: int) -> Array | None:
    """Where the rod of link ``index`` ends, in the link's frame; None when there is nothing to draw."""
    behind = tree.joints[index + 1 : index + 2]
    end = behind[0].X_PJ[:3, 3] if behind else tree.X_LT[:3, 3]
    return end if np.linalg.norm(end) > _SHORTEST_M else None


BASE = "base"
_TOPICS = {
    "joint_commands_topic": "/longreach/joint_commands",
    "joint_states_topic": "/joint_states",
    "trigger_joint_command_threshold": "-1",  # every command, also one that holds: silence is a fault here
}
_INTERFACES = (("command", "position"), ("command", "velocity"), ("state", "position"))
_UNLIMITED = 1e9  # N m and rad/s: URDF asks for both of every joint, also where nobody knows them
# For MuJoCo's reader, which would else melt the tool into the last link and refuse links without mass.
_FOR_MUJOCO = {
    "fusestatic": "false", "discardvisual": "false", "balanceinertia": "false", "inertiafromgeom": "false",
}  # fmt: skip
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
            if tree.collides:
                _add_capsule(link, end)
        _add_joint(robot, joint, before)
        before = f"{joint.name}_link"
    etree.SubElement(robot, "link", name=TOOL)
    fixed = etree.SubElement(robot, "joint", name="tool_mount", type="fixed")
    _add_place(fixed, tree.X_LT, before, TOOL)
    for frame in tree.frames:
        etree.SubElement(robot, "link", name=frame.name)
        mount = etree.SubElement(robot, "joint", name=f"{frame.name}_mount", type="fixed")
        _add_place(mount, frame.X_PF, frame.parent, frame.name)
    if tree.frames:
        _add_ros2_control(robot, tree)
    return document(robot, tree)


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
    speed, effort = (repr(_UNLIMITED if most is None else most) for most in (joint.speed, joint.effort))
    etree.SubElement(element, "limit", lower=lower, upper=upper, effort=effort, velocity=speed)
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


def _add_capsule(link: etree.Element, end: Array) -> None:
    """What collides: the rod, and a ball at each of its ends, since URDF has no capsules."""
    _add_rod(link, end, "collision")
    for place in (np.zeros(3), end):
        ball = etree.SubElement(link, "collision")
        etree.SubElement(ball, "origin", xyz=numbers(place), rpy="0 0 0")
        etree.SubElement(etree.SubElement(ball, "geometry"), "sphere", radius=repr(RADIUS_M))


def _add_rod(link: etree.Element, end: Array, kind: str = "visual") -> None:
    """A cylinder from the link's origin to ``end``."""
    x, y, z = (float(value) for value in end)
    visual = etree.SubElement(link, kind)
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
        attributes = {"pos": numbers(lump.centre), "mass": repr(lump.mass), "fullinertia": numbers(entries)}
        etree.SubElement(body, "inertial", attributes)
    return body


def _add_hinge(body: etree.Element, joint: TreeJoint, X_LJ: Array) -> None:
    """A hinge at ``X_LJ`` in the body's frame."""
    attributes = {"name": joint.name, "type": "hinge", "range": numbers(joint.limits)}
    attributes |= {"pos": numbers(X_LJ[:3, 3]), "axis": numbers(X_LJ[:3, :3] @ joint.axis)}
    if joint.stiffness > 0.0:
        attributes |= {"stiffness": repr(joint.stiffness), "damping": repr(joint.damping)}
    etree.SubElement(body, "joint", attributes)


def _add_mjcf_rod(body: etree.Element, end: Array) -> None:
    """A capsule from the body's origin to ``end``: to be seen, without mass or contact."""
    attributes = {"type": "capsule", "fromto": f"0 0 0 {numbers(end)}", "size": repr(RADIUS_M), "mass": "0"}
    etree.SubElement(body, "geom", attributes | {"contype": "0", "conaffinity": "0"})


def _place(X: Array) -> dict[str, str]:
    return {"pos": numbers(X[:3, 3]), "quat": numbers(quaternion_from_rotation(X[:3, :3]))}
