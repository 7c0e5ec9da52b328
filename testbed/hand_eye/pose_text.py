"""Numbers, units and rotations as files write them, refused with their place if not to be believed."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import RequestRefused
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array

_NORM_TOLERANCE = 0.02
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}


def file_text(path: Path) -> str:
    """What is in the file. Raises RequestRefused when it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RequestRefused("refused.hand_eye.unreadable", f"{path}: {error}") from error


def unit_scale(name: Any) -> float:
    """Metres of one unit of that name. Raises RequestRefused for an unknown one."""
    if name not in UNITS:
        raise RequestRefused(
            "refused.hand_eye.units", f"length_unit is {name!r}, known are {', '.join(UNITS)}"
        )
    return UNITS[name]


def rotation_of_quaternion(q_wxyz: Array, where: str, normalise: bool) -> Array:
    """The rotation (3, 3) of a quaternion (4,) of norm 1, or of any norm where ``normalise`` says so."""
    norm = float(np.linalg.norm(q_wxyz))
    if norm < 1e-6 or (abs(norm - 1.0) > _NORM_TOLERANCE and not normalise):
        raise RequestRefused(
            "refused.hand_eye.quaternion_norm",
            f"{where}: quaternion has norm {norm:.3f}, not 1; ask to normalise it if it has few digits",
        )
    return stacks.rotation_from_quaternion(q_wxyz)


def rotation_of_vector(v: Array, where: str) -> Array:
    """The rotation (3, 3) of a rotation vector (3,) in rad; beyond a full turn it is taken for degrees."""
    if float(np.linalg.norm(v)) > 2.0 * math.pi:
        raise RequestRefused(
            "refused.hand_eye.units",
            f"{where}: rotation vector of {np.linalg.norm(v):.1f} rad; is it in degrees?",
        )
    return stacks.exp_so3(v)


def numbers(value: Any, count: int, where: str) -> Array:
    """``value`` as ``count`` numbers, in one row. Raises RequestRefused when it is something else."""
    try:
        array = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise RequestRefused("refused.hand_eye.format", f"{where}: {count} numbers are wanted") from error
    if array.size != count:
        raise RequestRefused(
            "refused.hand_eye.format", f"{where}: {count} numbers are wanted, got {array.size}"
        )
    return array
