"""Poses as files and robots write them: numbers, units, rotations, and one line a pose in each form.

What is not to be believed is refused with its place.
"""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from foundation.foreign_text import decimal_points, read_text, unreadable
from foundation.numbers_as_written import written_number
from protocol.errors import RequestRefused
from testbed.choices import PoseForm
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import check_pose
from vision_pc.core.se3 import Array

_NORM_TOLERANCE = 0.02
# What robots write around their numbers: declarations, the kind of a pose, p before a bracket.
_AROUND = re.compile(
    r"(?i)^(?:decl|const|pers|var|local|task|global)\s[^={\[]*=|\b(?:e6)?pos\s*:|\bframe\s*:|\bp(?=\s*\[)"
)
_BETWEEN = re.compile(r'[,;\s\[\](){}"=]+|:(?=[\s=\[{])')
_CLOSING = re.compile(r"[\s\])};,]+$")
_NUMBER = re.compile(r"(?i)[-+\u2212]?[\d.]+(e[-+]?\d+)?")
_NO_NAME = re.compile(r"(?i)[-+.\u2212\d]|(nan|inf)\b")
# A column's name: what stands before the letter of its axis, that letter, a unit.
_COLUMN = re.compile(
    r"((?:[\w.]*[_.])?(?:[pqtr]|pos|trans|rot|quat|orient|(?:posi|transla|rota|orienta)tion|quaternion)?[_.]?)"
    r"([wxyzsrijk0-4])(?:_(?:c?mm?|deg|rad))?"
)
_ANGLE = re.compile(r"(?:[\w.]*[_.])?(roll|pitch|yaw)(?:_(?:deg|rad))?")
_TURNS = re.compile(r"(?:^|[_.])(?:q|rot|orient)|^r_?$")
_AXES = dict(zip("wxyzsrijk0123", "wxyzwwxyzwxyz", strict=True)) | {"roll": "x", "pitch": "y", "yaw": "z"}
_FANUC = {"w": "roll", "p": "pitch", "r": "yaw"}
_COLUMN_UNIT = re.compile(r"(?im)^\W*[a-z].*(?:\b|_)(?:[pt]|pos)?[xyz][\s_]*[\[(]?(mm|cm)\b")
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}


def file_text(path: Path) -> str:
    """What is in the file. Raises RequestRefused when it cannot be read."""
    try:
        return read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise RequestRefused("refused.hand_eye.unreadable", f"{path}: {unreadable(error)}") from error


class PoseLine(NamedTuple):
    """One line of a file of poses: ``where`` it stands, and its words."""

    where: str
    words: list[str]


def pose_lines(path: Path) -> list[PoseLine]:
    """The lines of a file with a pose a line, without comments and a first line of names alone.

    Words stand between commas, semicolons, tabs or blanks, in the brackets and behind the letters that robots
    write (``p[…]``, ``{E6POS: X …, Y …}``). Raises RequestRefused.
    """
    lines = [(k, line.split("#", 1)[0].strip()) for k, line in enumerate(file_text(path).splitlines(), 1)]
    lines = [(k, _CLOSING.sub("", _AROUND.sub(" ", line))) for k, line in lines if line]
    try:
        rows = decimal_points([line for _, line in lines])
    except ValueError as error:
        raise RequestRefused("refused.hand_eye.format", f"{path.name}: {error}") from error
    found: list[PoseLine] = []
    for (k, _), row in zip(lines, rows, strict=True):
        words = [word for word in _BETWEEN.split(row) if word]
        for named in (0, 1):  # by a picture's name
            if [word.upper() for word in words[named::2]][:6] == list("XYZABC"):
                words = words[:named] + words[named + 1 :: 2][:6]
        if found or any(map(_NO_NAME.match, words)):
            found.append(PoseLine(f"{path.name}: line {k}", words))
    return found


def heading(
    path: Path, turns: str = "wxyz", columns: list[int] | None = None
) -> tuple[list[int] | None, str | None]:
    """Where x y z and the ``turns`` are among the columns of a pose (of a quaternion, or the axes of Euler
    angles in their order), and the unit of lengths, as the file names them; ``columns`` and None where it
    does not. Raises RequestRefused for names that do not tell, where there are no ``columns``.
    """
    text = file_text(path)
    unit = _COLUMN_UNIT.search(text)
    length = None if unit is None else unit[1].lower()
    for line in filter(re.compile("[xyzXYZ]").search, text.splitlines()):
        named = _named_axes(line)[: 3 + len(turns)]
        axes, turned = [axis for _, axis in named], [k for k, (turn, _) in enumerate(named) if turn]
        for first in (3, 0):
            others = [k for k in range(len(axes)) if not first <= k < first + len(turns)]
            place, turn = [axes[k] for k in others], axes[first : first + len(turns)]
            if sorted(place) == list("xyz") and sorted(turn) == sorted(turns) and not {*turned} & {*others}:
                at = [others[place.index(axis)] for axis in "xyz"]
                return at + [first + turn.index(axis) for axis in turns], length
        if len(axes) == 7 and len(turned) == 4 and columns is None:
            why = f"which column is w does not follow from {line.strip()[:80]!r}: name them qw qx qy qz"
            raise RequestRefused("refused.hand_eye.format", f"{path.name}: {why}")
    return columns, length


def _named_axes(line: str) -> list[tuple[bool, str]]:
    """Whether it turns, and its axis, of every column that ``line`` names."""
    words = [word for word in re.split(r"[^\w.]+", line.lower()) if word]
    if words[3:6] == list(_FANUC) or words[:3] == list(_FANUC):
        words = [_FANUC.get(word, word) for word in words]
    found = []
    for word in words:
        if angle := _ANGLE.fullmatch(word):
            found.append((True, _AXES[angle[1]]))
        elif column := _COLUMN.fullmatch(word):
            turns = bool(_TURNS.search(column[1])) or (column[2] in "ijk" and {*"wijk"} <= {*words})
            if turns or column[2] in "wxyz":
                found.append((turns, _AXES.get(column[2], column[2])))
    return found


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
    cells = np.ravel(np.asarray(value, dtype=object))
    if cells.size != count:
        raise RequestRefused(
            "refused.hand_eye.format", f"{where}: {count} numbers are wanted, got {cells.size}"
        )
    try:
        return np.array([written_number(cell) for cell in cells])
    except ValueError as error:
        raise RequestRefused("refused.hand_eye.format", f"{where}: {error}") from error


_COUNTS = {PoseForm.EULER: 6, PoseForm.EULER_RAD: 6, PoseForm.UR: 6, PoseForm.KUKA: 6,
           PoseForm.MATRIX: 16, PoseForm.FRANKA: 16, PoseForm.TUM: 8}  # fmt: skip
_IN_MM = (PoseForm.KUKA, PoseForm.ABB)
_IN_ANGLES = (PoseForm.EULER, PoseForm.EULER_RAD, PoseForm.KUKA)
_ROBTARGET = 17  # ABB's: a pose, four of the configuration and six outer axes
W_FIRST, W_LAST = [0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 6, 3, 4, 5]  # columns of x y z, q_w q_x q_y q_z
_ORDER = re.compile(r"(?:[xyz]{3}|[XYZ]{3})\Z")


class RobotPoses(NamedTuple):
    """``X_BT`` (n, 4, 4) m; ``names`` of the pictures they belong to, None where the file has none."""

    X_BT: Array
    names: tuple[str, ...] | None


def read_robot_poses(
    path: Path, form: PoseForm, unit: str | None = None, order: str = "ZYX", normalise: bool = False
) -> RobotPoses:
    """The poses of a file with a line a pose, numbers between commas, semicolons or blanks.

    A first word that is no number names the picture; a first line without numbers is a header, whose order of
    a quaternion and unit are obeyed. ``unit`` is that of positions (by default mm of KUKA and ABB, else m).
    ``order`` of Euler angles: capital letters turn about the turned axes one after the other (intrinsic),
    small ones about fixed axes. Raises RequestRefused with file and line.
    """
    if form in (PoseForm.EULER, PoseForm.EULER_RAD) and not (
        _ORDER.match(order) and order[0] != order[1] != order[2]
    ):
        raise RequestRefused(
            "refused.hand_eye.format", f"Euler order {order!r}: such as ZYX or xyz is wanted"
        )
    angles = form in (PoseForm.EULER, PoseForm.EULER_RAD)
    usual = W_FIRST if form in (PoseForm.QUATERNION_WXYZ, PoseForm.ABB) else None
    turns = order.lower() if angles and len(set(order)) == 3 else "wxyz"
    columns, written = heading(path, turns, usual)
    columns = columns or (list(range(6)) if angles else W_LAST)
    scale = unit_scale(unit or written or ("mm" if form in _IN_MM else "m"))
    poses: list[Array] = []
    names: list[str | None] = []
    widest = 0.0
    for line in pose_lines(path):
        words = line.words
        if form is PoseForm.ABB and len(words) >= _ROBTARGET:
            words = words[: len(words) - _ROBTARGET + 7]
        name = None if _NUMBER.fullmatch(words[0]) or len(words) == _COUNTS.get(form, 7) else words.pop(0)
        values = numbers(words, _COUNTS.get(form, 7), f"{line.where} ({form})")
        values = values[columns] if angles else values
        widest = max(widest, float(np.abs(values[3:]).max()))
        p, R = _parse_pose(values, form, order, columns, line.where, normalise)
        poses.append(se3.transform(R, scale * p))
        check_pose(poses[-1], line.where)
        names.append(name)
    if not poses:
        raise RequestRefused("refused.hand_eye.count", f"{path.name}: no pose in it")
    if form in _IN_ANGLES:
        _question_angles(form, widest, path.name)
    if any(name is None for name in names) and any(names):
        raise RequestRefused(
            "refused.hand_eye.format", f"{path.name}: some lines name a picture, some do not"
        )
    named = tuple(str(name) for name in names)
    return RobotPoses(np.stack(poses), named if names[0] is not None else None)


def _question_angles(form: PoseForm, widest: float, where: str) -> None:
    """Raise RequestRefused where the widest of all angles is no more than a turn in radians, and degrees are
    wanted, or more, and radians are.
    """
    small = widest <= 2.0 * math.pi
    wanted, given = ("degrees", "radians") if small else ("radians", "degrees")
    if widest and small != (form is PoseForm.EULER_RAD):
        why = f"the widest angle is {widest:.4g}, {wanted} are wanted; are they {given}? Then"
        other = PoseForm.EULER_RAD if small else PoseForm.EULER
        raise RequestRefused("refused.hand_eye.units", f"{where}: {why} --poses {other} reads them")


def _parse_pose(
    v: Array, form: PoseForm, order: str, columns: list[int], where: str, normalise: bool
) -> tuple[Array, Array]:
    """Position in the file's unit, and rotation."""
    if form in (PoseForm.MATRIX, PoseForm.FRANKA):
        X = v.reshape(4, 4, order="F" if form is PoseForm.FRANKA else "C")
        if np.abs(X[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
            raise RequestRefused(
                "refused.hand_eye.not_a_pose", f"{where}: last row is {X[3].tolist()}, not 0 0 0 1; is it "
                "written by columns (franka) or by rows (matrix)?"
            )  # fmt: skip
        return X[:3, 3], X[:3, :3]
    if form is PoseForm.UR:
        return v[:3], rotation_of_vector(v[3:], where)
    if form is PoseForm.KUKA:
        return v[:3], Rotation.from_euler("ZYX", v[3:], degrees=True).as_matrix()
    if form in (PoseForm.EULER, PoseForm.EULER_RAD):
        return v[:3], Rotation.from_euler(order, v[3:], degrees=form is PoseForm.EULER).as_matrix()
    v = v[-7:][columns]
    return v[:3], rotation_of_quaternion(v[3:], where, normalise)
