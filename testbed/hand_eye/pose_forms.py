"""The ways in which robots write poses."""

from enum import StrEnum


class PoseForm(StrEnum):
    """How a line of the file gives a pose; angles of Euler and KUKA are degrees, of ``euler-rad`` radians."""

    QUATERNION_XYZW = "xyzw"
    QUATERNION_WXYZ = "wxyz"
    EULER = "euler"
    EULER_RAD = "euler-rad"
    MATRIX = "matrix"
    UR = "ur"
    KUKA = "kuka"
    ABB = "abb"
    FRANKA = "franka"
    TUM = "tum"
