"""What the writers of XML share: numbers with all their digits, and a document with its comment."""

from xml.etree import ElementTree as etree

import numpy as np
from numpy.typing import ArrayLike

from testbed.exports.arm_tree import ArmTree
from vision_pc.core.se3 import Array

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
