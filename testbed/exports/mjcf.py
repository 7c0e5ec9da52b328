"""An arm as MJCF, MuJoCo's own format: the same tree with springs, damping and gravity."""

from xml.etree import ElementTree as etree

import numpy as np

from testbed.exports.arm_tree import ArmTree, TreeJoint
from testbed.exports.xml_text import RADIUS_M, TOOL, document, numbers, rod_end
from vision_pc.core.se3 import Array, inverse, quaternion_from_rotation

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
            _add_rod(inside, end)
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


def _add_rod(body: etree.Element, end: Array) -> None:
    """A capsule from the body's origin to ``end``: to be seen, without mass or contact."""
    told = {"type": "capsule", "fromto": f"0 0 0 {numbers(end)}", "size": repr(RADIUS_M), "mass": "0"}
    etree.SubElement(body, "geom", told | {"contype": "0", "conaffinity": "0"})


def _place(X: Array) -> dict[str, str]:
    return {"pos": numbers(X[:3, 3]), "quat": numbers(quaternion_from_rotation(X[:3, :3]))}
