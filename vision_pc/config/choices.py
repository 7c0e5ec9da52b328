"""Words to choose from, of settings and of the command line, whose help imports nothing heavier."""

from enum import StrEnum


class LensModel(StrEnum):
    """How a lens bends rays; coefficients in OpenCV's order and signs.

    ``brown-conrady`` k1 k2 p1 p2 k3 (ROS plumb_bob, Kalibr radtan), ``rational`` k1 k2 p1 p2 k3 k4 k5 k6,
    ``fisheye`` k1 k2 k3 k4 (Kannala-Brandt; Kalibr and ROS: equidistant).
    """

    BROWN_CONRADY = "brown-conrady"
    RATIONAL = "rational"
    FISHEYE = "fisheye"


class Setup(StrEnum):
    """Where the camera is mounted."""

    EYE_IN_HAND = "eye-in-hand"
    EYE_TO_HAND = "eye-to-hand"


class Detector(StrEnum):
    """How the corners of a checkerboard are found."""

    CLASSIC = "classic"
    FITTED = "fitted"
    SECTORS = "sectors"


class Method(StrEnum):
    """All solvers. The equation that each one solves: ``Method.equation``."""

    TSAI = "tsai"
    PARK = "park"
    HORAUD = "horaud"
    ANDREFF = "andreff"
    DANIILIDIS = "daniilidis"
    LI = "li"
    SHAH = "shah"
    DQCR = "dqcr"
    MAXIMUM_LIKELIHOOD = "maximum-likelihood"
    ROBUST = "robust"

    @property
    def equation(self) -> str:
        """``AX=XB`` (relative motions) or ``AX=ZB`` (poses; X and Z together)."""
        return "AX=ZB" if self in _POSE_METHODS else "AX=XB"


_POSE_METHODS = {Method.LI, Method.SHAH, Method.MAXIMUM_LIKELIHOOD, Method.ROBUST}


class PositioningMethod(StrEnum):
    """How look-then-move drives: by the local error model with corrections, or by the paper's rotation."""

    CORRECTED = "corrected"
    PAPER = "paper"
