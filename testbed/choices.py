"""What options choose from: the controllers, the clocks, and the ways in which robots write poses."""

from enum import StrEnum
from typing import NamedTuple


class ControllerKind(StrEnum):
    """In which language the controller is written that runs; the value is the option's."""

    PYTHON = "python"
    STRUCTURED_TEXT = "st"

    @property
    def module(self) -> str:
        """What is run as its process."""
        return "controller" if self is ControllerKind.PYTHON else "controller_st"


class ClockKind(StrEnum):
    """Whose time all parts go by; the value is the option's."""

    PLANT = "plant"
    WALL = "wall"


class Timing(NamedTuple):
    """``clock``: None: the plant's, where no part is somebody else's. ``pace``: the most times real time, 0:
    as fast as all parts answer. ``goes``: what ``PUT /clock`` takes, at the start.
    """

    clock: ClockKind | None = None
    pace: float = 1.0
    goes: str = "always"


USUAL_TIMING = Timing()


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
