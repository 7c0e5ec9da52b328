"""What all readers of calibration files share: numbers with their key, matrices, turns, and our value
made.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from protocol.errors import ConfigurationError
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import COEFFICIENTS, FORMAT, StereoCalibration

Matrix = NDArray[np.float64]

_SHOWN = 100  # characters: a longer value does not help
_SQUARE = 2e-3  # how far a printed rotation may be from a rotation


class Pinhole(NamedTuple):
    """One eye as a file has it: ``K`` (3, 3) px, its lens and coefficients, picture size, and where it is
    known the covariance of both eyes, this one's numbers first.
    """

    K: Matrix
    lens: LensModel
    distortion: tuple[float, ...]
    size: tuple[int, int]
    covariance: tuple[tuple[float, ...], ...] | None = None


def refused(path: Path, key: str, found: object, wanted: str) -> ConfigurationError:
    """The error of a calibration file: what stands where, and what was wanted."""
    return ConfigurationError("configuration.bad_calibration", f"{path}: {key} = {found!r}: {wanted}")


def missing(path: Path, key: str, wanted: str) -> ConfigurationError:
    """The error of a calibration file without a key."""
    return ConfigurationError("configuration.bad_calibration", f"{path}: {key} is missing: {wanted}")


def number(path: Path, key: str, value: Any) -> float:
    """``value`` as a finite number. Raises ConfigurationError."""
    try:
        found = float(value)
    except (TypeError, ValueError) as error:
        raise refused(path, key, value, "a number is wanted") from error
    if not math.isfinite(found):
        raise refused(path, key, value, "a finite number is wanted")
    return found


def matrix(path: Path, key: str, value: Any, shape: tuple[int, int]) -> Matrix:
    """``value``, rows or a flat list, as a matrix of ``shape``. Raises ConfigurationError."""
    try:
        found = np.asarray(value, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError) as error:
        raise refused(path, key, value, f"{shape[0]}x{shape[1]} numbers are wanted") from error
    if not np.isfinite(found).all():
        raise refused(path, key, value, "finite numbers are wanted")
    return found


def numbers(path: Path, key: str, value: Any) -> tuple[float, ...]:
    """``value`` as a flat list of finite numbers. Raises ConfigurationError."""
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str):
        raise refused(path, key, value, "a list of numbers is wanted")
    return tuple(number(path, key, one) for one in np.ravel(np.asarray(value, dtype=object)))


def rotation_vector(path: Path, key: str, R: Matrix) -> Matrix:
    """The rotation vector (3,) rad of ``R`` (3, 3) turned by less than 180°. Raises ConfigurationError."""
    if np.abs(R @ R.T - np.eye(3)).max() > _SQUARE or np.linalg.det(R) < 0.0:
        raise refused(path, key, R.tolist(), "a rotation is wanted (orthonormal, right-handed)")
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(R)) - 1.0))
    return np.asarray(axis if sine < 1e-9 else axis * (angle / sine))


def rotation(vector: Matrix) -> Matrix:
    """The rotation (3, 3) of a rotation vector (3,) rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-12:
        return np.asarray(np.eye(3) + cross)
    sine, versine = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + sine * cross + versine * cross @ cross)


def brown_or_rational(path: Path, key: str, values: Sequence[float]) -> tuple[LensModel, tuple[float, ...]]:
    """OpenCV's 0, 4, 5, 8, 12 or 14 coefficients as a lens. Raises ConfigurationError.

    The thin prism's and the tilted sensor's (the ninth and later) must be zero: they are not modelled.
    """
    given = tuple(values)
    if len(given) not in (0, 4, 5, 8, 12, 14):
        raise refused(path, key, list(given), "4, 5 or 8 coefficients k1 k2 p1 p2 k3 k4 k5 k6 are wanted")
    if any(given[8:]):
        raise refused(
            path,
            key,
            list(given),
            "thin prism and tilted sensor (from the ninth on) are not modelled: calibrate the camera with "
            "longreach camera calibrate",
        )
    if any(given[5:8]):
        return LensModel.RATIONAL, given[:8]
    return LensModel.BROWN_CONRADY, (*given[:5], *(0.0 for _ in range(5 - len(given[:5]))))


def equidistant(path: Path, key: str, values: Sequence[float]) -> tuple[LensModel, tuple[float, ...]]:
    """Four coefficients as a fisheye. Raises ConfigurationError."""
    if len(values) != len(COEFFICIENTS[LensModel.FISHEYE]):
        raise refused(path, key, list(values), "4 coefficients k1 k2 k3 k4 of a fisheye are wanted")
    return LensModel.FISHEYE, tuple(values)


def assembled(
    path: Path, source: str, eyes: tuple[Pinhole, Pinhole], R_RC: Matrix, t_RC: Matrix
) -> StereoCalibration:
    """The calibration of two eyes; a point p of the left one is at ``R_RC`` p + ``t_RC`` (m) in the right
    one.

    Raises ConfigurationError where the eyes do not fit together.
    """
    left, right = eyes
    if left.size != right.size:
        raise refused(path, "picture size", (left.size, right.size), "both eyes' pictures are of one size")
    turn = -rotation_vector(path, "rotation of the right eye", R_RC)
    place = -R_RC.T @ t_RC
    document = {
        "format": FORMAT,
        "source": source + _skew_left_out(eyes),
        "width_px": left.size[0],
        "height_px": left.size[1],
        "left": _eye(left),
        "right": _eye(right),
        "right_position_m": tuple(place.tolist()),
        "right_rotation_vector_deg": tuple(np.degrees(turn).tolist()),
    }
    return made(path, document)


def _skew_left_out(eyes: tuple[Pinhole, Pinhole]) -> str:
    """What is said of skewed axes, which our lenses do not have; empty where there are none."""
    skews = [float(eye.K[0, 1]) for eye in eyes]
    return f"; skew {skews[0]:g} and {skews[1]:g} px left out" if any(skews) else ""


def _eye(eye: Pinhole) -> dict[str, Any]:
    K = eye.K
    places = {"fx_px": K[0, 0], "fy_px": K[1, 1], "cx_px": K[0, 2], "cy_px": K[1, 2]}
    return {name: float(value) for name, value in places.items()} | {
        "lens": eye.lens,
        "distortion": eye.distortion,
    }


def made(path: Path, document: Mapping[str, Any]) -> StereoCalibration:
    """``document`` as a calibration. Raises ConfigurationError that names the file."""
    try:
        return StereoCalibration.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        why = str(first["msg"]).removeprefix("Value error, ")
        key = ".".join(map(str, first["loc"]))
        told = f"{key} = {first['input']!r}: {why}" if len(str(first["input"])) < _SHOWN else f"{key}: {why}"
        raise ConfigurationError(
            "configuration.bad_calibration", f"{path}: {told.removeprefix(': ')}"
        ) from error
