"""What options choose from: the controllers, and the ways in which robots write poses."""

from enum import StrEnum


class ControllerKind(StrEnum):
    """In which language the controller is written that runs; the value is the option's."""

    PYTHON = "python"
    STRUCTURED_TEXT = "st"

    @property
    def module(self) -> str:
        """What is run as its process."""
        return "controller" if self is ControllerKind.PYTHON else "controller_st"


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
