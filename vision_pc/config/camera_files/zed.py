"""The factory's file of a ZED camera, ``SNxxxx.conf``.

Its conventions, from Stereolabs' own ``zed_opencv_native.py`` (zed-opencv-native) and from what writes such
files (``stereo_calibration``, zedx-one-capture): the turn of the right eye is one Rodrigues vector (RX, CV,
RZ) rad, and with lengths in mm a point p of the left eye is at R p + (-Baseline, TY, TZ) in the right one,
as cv2.stereoCalibrate has it. The C++ samples hand +Baseline to cv2.stereoRectify, which takes either sign
of the whole vector, so that TY and TZ act the other way round there; the writer decides.
"""

import configparser
from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import ConfigurationError
from vision_pc.config.camera_files.parts import (
    Matrix,
    Pinhole,
    assembled,
    brown_or_rational,
    missing,
    number,
    rotation,
)
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import COEFFICIENTS, StereoCalibration

RESOLUTIONS = {
    (2208, 1242): "2K",
    (1920, 1080): "FHD",
    (1280, 720): "HD",
    (672, 376): "VGA",
    (1920, 1200): "FHD1200",
    (960, 600): "SVGA",
}
_RATIONAL = COEFFICIENTS[LensModel.RATIONAL]


def read_zed(path: Path, text: str, size: tuple[int, int]) -> StereoCalibration:
    """The calibration in ``text`` for pictures of ``size`` (width, height) an eye.

    Raises ConfigurationError (``configuration.bad_calibration``, ``.calibration_size``).
    """
    if size not in RESOLUTIONS:
        known = ", ".join(f"{name} {w}x{h}" for (w, h), name in RESOLUTIONS.items())
        raise ConfigurationError(
            "configuration.calibration_size",
            f"{path}: no ZED takes pictures of {size[0]}x{size[1]} px an eye; known: {known}",
        )
    sections = _parsed(path, text)
    mode = RESOLUTIONS[size]
    stereo = _section(path, sections, "STEREO", "it has Baseline, RX, CV, RZ")
    left, right = (_eye(path, sections, side, mode, size) for side in ("LEFT", "RIGHT"))
    turn = np.array(
        [
            number(path, f"[STEREO] {key}_{mode}", _value(path, stereo, key, mode))
            for key in ("RX", "CV", "RZ")
        ]
    )
    shift = np.array([-number(path, "[STEREO] Baseline", _wanted(path, stereo, "STEREO", "baseline")),
                      *(_optional(path, stereo, key, mode) for key in ("TY", "TZ"))])  # fmt: skip
    source = f"{path.name} [{mode}], ZED factory file"
    return assembled(path, source, (left, right), rotation(turn), 1e-3 * shift)


def _parsed(path: Path, text: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=True, interpolation=None, inline_comment_prefixes=("#", ";"))
    try:
        parser.read_string(text)
    except configparser.Error as error:
        why = " ".join(str(error).split())
        raise ConfigurationError("configuration.bad_calibration", f"{path}: no ZED file: {why}") from error
    return parser


def _section(path: Path, sections: configparser.ConfigParser, name: str, wanted: str) -> Any:
    if name not in sections:
        raise missing(
            path, f"[{name}]", f"{wanted}; the file has {', '.join(sections.sections()) or 'no section'}"
        )
    return sections[name]


def _wanted(path: Path, section: Any, name: str, key: str) -> str:
    value = section.get(key)
    if value is None:
        raise missing(path, f"[{name}] {key}", "a number")
    return str(value)


def _value(path: Path, stereo: Any, key: str, mode: str) -> str:
    """A turn of this resolution; CV and its like without one are of all resolutions."""
    for name in (f"{key}_{mode}", key):
        if (value := stereo.get(name)) is not None:
            return str(value)
    raise missing(path, f"[STEREO] {key}_{mode}", "radians; a file of another resolution cannot be used")


def _optional(path: Path, stereo: Any, key: str, mode: str) -> float:
    """A shift that older files leave out: then zero."""
    for name in (f"{key}_{mode}", key):
        if (value := stereo.get(name)) is not None:
            return number(path, f"[STEREO] {name}", value)
    return 0.0


def _eye(
    path: Path, sections: configparser.ConfigParser, side: str, mode: str, size: tuple[int, int]
) -> Pinhole:
    """One eye; distortion stands beside its focal length, or in a section of its own for all resolutions."""
    name = f"{side}_CAM_{mode}"
    eye = _section(path, sections, name, f"pictures of {size[0]}x{size[1]} px are wanted")
    K: Matrix = np.eye(3)
    for key, place in {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}.items():
        K[place] = number(path, f"[{name}] {key}", _wanted(path, eye, name, key))
    apart = f"{side}_DISTO"
    lens = sections[apart] if "k1" not in eye and apart in sections else eye
    where = apart if lens is not eye else name
    if "k4" in lens and "p1" not in lens:
        fisheye = COEFFICIENTS[LensModel.FISHEYE]
        values = tuple(number(path, f"[{where}] {key}", _wanted(path, lens, where, key)) for key in fisheye)
        return Pinhole(K, LensModel.FISHEYE, values, size)
    _wanted(path, lens, where, "k1")
    found = [number(path, f"[{where}] {key}", lens.get(key, "0")) for key in _RATIONAL]
    return Pinhole(K, *brown_or_rational(path, f"[{where}] k1 …", found), size)
