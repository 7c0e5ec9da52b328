"""What all readers of calibration files share: entries with their key in refusals, lenses, our value made."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from foundation.configuration import fault_words
from foundation.numbers_as_written import written_number
from protocol.errors import ConfigurationError
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import COEFFICIENTS, FOCAL_PX, FORMAT, StereoCalibration

Matrix = NDArray[np.float64]

OFF_CENTRE = 0.15  # [D] of width or height: lenses and rectification move principal points by a tenth
_ALIKE = 1e-3  # of the focal length: how far a rectified pair's fx, fy and cy may differ
_SQUARE = 2e-3  # how far a printed rotation may be from a rotation
_FISHEYES = ("equidistant", "fisheye", "KannalaBrandt8")


class Pinhole(NamedTuple):
    """One eye as a file has it: ``K`` (3, 3) px, its lens and coefficients, picture size."""

    K: Matrix
    lens: LensModel
    distortion: tuple[float, ...]
    size: tuple[int, int]


def bad_calibration(path: Path, why: str) -> ConfigurationError:
    """The error of a calibration file."""
    return ConfigurationError("configuration.bad_calibration", f"{path}: {why}")


class Entries(NamedTuple):
    """A mapping of a calibration file; ``place`` stands before its keys in refusals. All methods raise
    ConfigurationError that names file, key, value and what was wanted.
    """

    path: Path
    values: Mapping[str, Any]
    place: str = ""

    def refused(self, key: str, found: object, expected: str) -> ConfigurationError:
        """The error of a value that is not ``expected``."""
        return bad_calibration(self.path, f"{self.place}{key} = {found!r}: {expected}")

    def missing(self, key: str, expected: str) -> ConfigurationError:
        """The error of a key that is not there."""
        return bad_calibration(self.path, f"{self.place}{key} is missing: {expected}")

    def entry(self, expected: str, *names: str) -> Any:
        """The value under the first of ``names`` that is there."""
        for name in names:
            if name in self.values:
                return self.values[name]
        raise self.missing(names[0], expected)

    def number(self, key: str, value: Any = None) -> float:
        """``value``, or else that of ``key``, as a finite number."""
        value = self.entry("a number", key) if value is None else value
        try:
            return written_number(value)
        except ValueError as error:
            raise self.refused(key, value, "a finite number is wanted, in decimal digits") from error

    def numbers(self, key: str, value: Any, expected: int | None = None) -> tuple[float, ...]:
        """``value``, a list, rows, or a matrix of OpenCV or ROS (rows, cols, data), as a flat list."""
        if isinstance(value, Mapping) and "data" in value:
            found = self.numbers(f"{key}.data", value["data"])
            rows, columns = (self.number(f"{key}.{name}", value.get(name, 1)) for name in ("rows", "cols"))
            if rows * columns != len(found) and {"rows", "cols"} <= set(value):
                raise self.refused(
                    f"{key}.data", list(found), f"rows times cols, {rows * columns:g}, are wanted"
                )
        elif not isinstance(value, list | tuple):
            raise self.refused(key, value, "a list of numbers is wanted")
        else:
            lists = list(value) if any(isinstance(one, list) for one in value) else [value]
            if any(not isinstance(row, list | tuple) or len(row) != len(lists[0]) for row in lists):
                raise self.refused(key, value, "numbers, or rows of one length, are wanted")
            found = tuple(self.number(key, "" if one is None else one) for row in lists for one in row)
        if expected is not None and len(found) != expected:
            raise self.refused(key, list(found), f"{expected} numbers are wanted, got {len(found)}")
        return found

    def matrix(self, key: str, value: Any, shape: tuple[int, int]) -> Matrix:
        """``value``, rows or a flat list, as a matrix of ``shape``."""
        return np.array(self.numbers(key, value, shape[0] * shape[1])).reshape(shape)

    def camera_matrix(self, key: str, value: Any, columns: int = 3) -> Matrix:
        """``value`` as K, or K and a fourth column: fx s cx, 0 fy cy, 0 0 1, px."""
        K = self.matrix(key, value, (3, columns))
        if K[1, 0] or K[2, :3].tolist() != [0.0, 0.0, 1.0]:
            why = "fx s cx, 0 fy cy, 0 0 1 are wanted in rows; MATLAB writes columns, of its rotation too"
            raise self.refused(key, K.tolist(), why)
        return K

    def alike(self, key: str, P: Matrix, first: Matrix) -> None:
        """Refuse ``P`` (3, 4) that is not of one rectified pair with the ``first`` eye's."""
        for name, place in {"fx": (0, 0), "fy": (1, 1), "cy": (1, 2)}.items():
            if abs(P[place] - first[place]) > _ALIKE * P[0, 0]:
                why = (
                    f"{first[place]:g} of the left eye is wanted; fx, fy and cy of a rectified pair are alike"
                )
                raise self.refused(f"{key}'s {name}", float(P[place]), why)

    def pinhole(self, keys: Sequence[str]) -> Matrix:
        """K (3, 3) px from the entries for fx, fy, cx and cy."""
        fx, fy, cx, cy = (self.number(key) for key in keys)
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def size(self, keys: tuple[str, str], values: Sequence[Any]) -> tuple[int, int]:
        """Width and height of a picture, px."""
        found = [self.number(key, value) for key, value in zip(keys, values, strict=True)]
        for key, value in zip(keys, found, strict=True):
            if value < 1.0 or not value.is_integer():
                raise self.refused(key, value, "a whole number of pixels is wanted")
        return int(found[0]), int(found[1])

    def lens(self, key: str, kind: str, values: Sequence[float]) -> tuple[LensModel, tuple[float, ...]]:
        """Coefficients of a lens that others call ``kind``: OpenCV's 0, 4, 5, 8, 12 or 14, or a fisheye's 4.

        The thin prism's and the tilted sensor's (the ninth and later) must be zero: they are not modelled.
        """
        given = tuple(values)
        if kind in _FISHEYES:
            if len(given) != len(COEFFICIENTS[LensModel.FISHEYE]):
                raise self.refused(key, list(given), "4 coefficients k1 k2 k3 k4 of a fisheye are wanted")
            return LensModel.FISHEYE, given
        if len(given) not in (0, 4, 5, 8, 12, 14):
            raise self.refused(key, list(given), "4, 5 or 8 coefficients k1 k2 p1 p2 k3 k4 k5 k6 are wanted")
        if any(given[8:]):
            why = (
                "thin prism and tilted sensor (from the ninth on) are not modelled: calibrate the camera with"
            )
            raise self.refused(key, list(given), f"{why} longreach camera calibrate")
        if any(given[5:8]):
            return LensModel.RATIONAL, given[:8]
        return LensModel.BROWN_CONRADY, (given + (0.0,) * 5)[:5]


def inverse(X: Matrix) -> Matrix:
    """The inverse of a pose (4, 4)."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = X[:3, :3].T, -X[:3, :3].T @ X[:3, 3]
    return made


def believed(eye: Pinhole, path: Path, name: str = "") -> Pinhole:
    """``eye`` again, that of ``name``. Raises ConfigurationError where it can hardly be of its pictures."""
    for k, axis in enumerate("xy"):
        focal, centre, middle = float(eye.K[k, k]), float(eye.K[k, 2]), 0.5 * eye.size[k]
        if not FOCAL_PX[0] <= focal <= FOCAL_PX[1]:
            wanted = f"{FOCAL_PX[0]:g} to {FOCAL_PX[1]:g} px are wanted; is it in millimetres?"
            raise Entries(path, {}).refused(f"{name}f{axis}", focal, wanted)
        off, most, size = abs(centre - middle), 2.0 * OFF_CENTRE * middle, "{}x{}".format(*eye.size)
        if off > most:
            why = (
                f"{off:.0f} px from the middle of pictures of {size}, at most {most:.0f} are believed; is it"
            )
            why += " for another size, or are width and height exchanged?"
            raise Entries(path, {}).refused(f"{name}c{axis}", centre, why)
    return eye


def assembled(
    path: Path, source: str, eyes: Sequence[Pinhole], R_RC: Matrix, t_RC: Matrix
) -> StereoCalibration:
    """The calibration of two eyes; a point p of the left one is at ``R_RC`` p + ``t_RC`` (m) in the right.

    Raises ConfigurationError where the eyes do not fit together.
    """
    file = Entries(path, {})
    left, right = believed(eyes[0], path, "left eye's "), believed(eyes[1], path, "right eye's ")
    if left.size != right.size:
        raise file.refused("picture size", (left.size, right.size), "both eyes' pictures are of one size")
    if np.abs(R_RC @ R_RC.T - np.eye(3)).max() > _SQUARE or np.linalg.det(R_RC) < 0.0:
        why = "a rotation is wanted (orthonormal, right-handed)"
        raise file.refused("rotation of the right eye", R_RC.tolist(), why)
    skews = [float(eye.K[0, 1]) for eye in eyes]
    note = f"; skew {skews[0]:g} and {skews[1]:g} px left out" if any(skews) else ""
    return made(path, document(source + note, (left, right), R_RC, t_RC))


def document(source: str, eyes: tuple[Pinhole, Pinhole], R_RC: Matrix, t_RC: Matrix) -> dict[str, Any]:
    """The content of our own file of two eyes of one size, the right one placed as ``assembled`` has it."""
    sides = [
        {
            "lens": eye.lens,
            "fx_px": float(eye.K[0, 0]),
            "fy_px": float(eye.K[1, 1]),
            "cx_px": float(eye.K[0, 2]),
            "cy_px": float(eye.K[1, 2]),
            "distortion": tuple(eye.distortion),
        }
        for eye in eyes
    ]
    return {
        "format": FORMAT,
        "source": source,
        "width_px": eyes[0].size[0],
        "height_px": eyes[0].size[1],
        "left": sides[0],
        "right": sides[1],
        "right_position_m": tuple((-R_RC.T @ t_RC).tolist()),
        "right_rotation_vector_deg": tuple((-np.degrees(cv2.Rodrigues(R_RC)[0])).ravel().tolist()),
    }


def made(path: Path, content: Mapping[str, Any]) -> StereoCalibration:
    """``content`` as a calibration. Raises ConfigurationError that names the file."""
    try:
        return StereoCalibration.model_validate(content)
    except ValidationError as error:
        raise bad_calibration(path, fault_words(error.errors()[0])) from error
