"""The arm as a tree of joints, and the XML that formats write."""

import math
from typing import NamedTuple
from xml.etree import ElementTree as etree

import numpy as np
from numpy.typing import ArrayLike

from nominal_arm.description import JOINT_NAMES, JointConfig, NominalArm
from nominal_arm.dimensions import DhLink, dh_links
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.mechanics.bodies import NOTHING, Lump
from plant_emulator.core.mechanics.geometry import transform
from plant_emulator.core.model import Model, build_model, put_payload
from vision_pc.core.se3 import Array

HINGE_RANGE_RAD = (
    0.5  # either way, told of a hinge: far more than any boom bends, so that a viewer has an end
)


class TreeJoint(NamedTuple):
    """One joint and the link behind it; joints follow each other, the first stands on the base B.

    ``X_PJ`` (4, 4) is the joint's frame at angle zero in the frame of the link before, ``axis`` (3,) lies in
    the joint's frame, in which ``body`` is given too (mass 0: none is known). ``limits`` rad, ``speed``
    rad/s (None: not known), ``stiffness`` N m/rad, ``damping`` N m s/rad. ``locked``: it does not turn.
    """

    name: str
    X_PJ: Array
    axis: Array
    limits: tuple[float, float]
    speed: float | None = None
    stiffness: float = 0.0
    damping: float = 0.0
    body: Lump = NOTHING
    locked: bool = False


class ArmTree(NamedTuple):
    """An arm: ``X_LT`` (4, 4) is the tool centre point T in the last link, ``gravity`` (3,) m/s² in B.

    ``about`` says in words what the arm is, and what of it is left out.
    """

    name: str
    joints: tuple[TreeJoint, ...]
    X_LT: Array
    gravity: Array
    about: str


def nominal_tree(arm: NominalArm) -> ArmTree:
    """The six joints of ``arm``: kinematics alone, since a nominal arm has neither masses nor gravity.

    The joint of row i turns about z of the frame that row i − 1 ends in, turned by the row's own offset.
    """
    links, found, before = dh_links(arm), [], np.eye(4)
    for link, joint in zip(links, arm.joints, strict=False):
        found.append(
            TreeJoint(
                joint.name,
                before @ _turn_z(link.theta_offset),
                np.array([0.0, 0.0, 1.0]),
                _limits(joint),
                math.radians(joint.speed_deg_s),
            )
        )
        before = _rest(link)
    mock = links[-1]
    tool = before @ _turn_z(mock.theta_offset) @ _rest(mock)
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
        float(mechanism.stiffness[i]),
        float(mechanism.damping[i]),
        body if body.mass > 0.0 else NOTHING,
        locked=mechanism.free[i] == 0.0,
    )


def _limits(joint: JointConfig) -> tuple[float, float]:
    return math.radians(joint.lower_deg), math.radians(joint.upper_deg)


def _turn_z(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return transform(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))


def _rest(link: DhLink) -> Array:
    """Tz(d) Tx(a) Rx(alpha): what of a link lies behind its joint."""
    c, s = math.cos(link.alpha), math.sin(link.alpha)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return transform(turned, np.array([link.a, 0.0, link.d]))


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
