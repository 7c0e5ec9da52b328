"""Reads any calibration file of a stereo camera, told by what is in it, and writes our own."""

import configparser
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from foundation.configuration import parse_mapping, parse_yaml
from foundation.foreign_text import decoded
from protocol.errors import ConfigurationError
from vision_pc.config.camera_files import yaml_files
from vision_pc.config.camera_files.parts import (
    Matrix,
    Pinhole,
    assembled,
    brown_or_rational,
    made,
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
    shift = np.array([-number(path, "[STEREO] Baseline", _required_text(path, stereo, "STEREO", "baseline")),
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


def _required_text(path: Path, section: Any, name: str, key: str) -> str:
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
        K[place] = number(path, f"[{name}] {key}", _required_text(path, eye, name, key))
    apart = f"{side}_DISTO"
    lens = sections[apart] if "k1" not in eye and apart in sections else eye
    where = apart if lens is not eye else name
    if "k4" in lens and "p1" not in lens:
        fisheye = COEFFICIENTS[LensModel.FISHEYE]
        values = tuple(
            number(path, f"[{where}] {key}", _required_text(path, lens, where, key)) for key in fisheye
        )
        return Pinhole(K, LensModel.FISHEYE, values, size)
    _required_text(path, lens, where, "k1")
    names = (*_RATIONAL, "s1", "s2", "s3", "s4")
    found = [number(path, f"[{where}] {key}", lens.get(key, "0")) for key in names]
    return Pinhole(K, *brown_or_rational(path, f"[{where}] k1 …", found), size)


_WANTED = "a ZED file (SNxxxx.conf), Kalibr's camchain, OpenCV's stereo YAML or our own is wanted"
_MOST_BYTES = 1 << 20


def read_calibration(
    path: Path, size: tuple[int, int] | None = None, length_m: float = 1.0
) -> StereoCalibration:
    """The calibration in ``path``.

    ``size`` (width, height) of one eye's picture chooses among a ZED file's resolutions, and stands in where
    a file has none (OpenCV); ``length_m`` is the unit of OpenCV's T. Raises ConfigurationError that names
    file, key, value and what was wanted.
    """
    text = _text(path)
    if _is_zed(path, text):
        if size is None:
            raise ConfigurationError(
                "configuration.calibration_size",
                f"{path}: a ZED file holds several picture sizes: give --size WIDTHxHEIGHT of one eye",
            )
        return read_zed(path, text, size)
    document = _document(path, text)
    if "format" in document:
        return made(path, document)
    if yaml_files.is_kalibr(document):
        return yaml_files.read_kalibr(path, document)
    if yaml_files.is_camera_info(document) or yaml_files.is_sensor(document):
        raise yaml_files.one_eye_alone(path)
    if yaml_files.is_opencv_stereo(document):
        return yaml_files.read_opencv_stereo(path, document, size, length_m)
    keys = ", ".join(str(key) for key in document)[:80] or "nothing"
    raise ConfigurationError("configuration.bad_calibration", f"{path}: has {keys}; {_WANTED}")


def read_calibrations(
    paths: Sequence[Path], size: tuple[int, int] | None = None, length_m: float = 1.0
) -> StereoCalibration:
    """The calibration in one file; or in two: ROS's left and right eye, or OpenCV's intrinsics and
    extrinsics.

    Raises ConfigurationError.
    """
    if len(paths) == 1:
        return read_calibration(paths[0], size, length_m)
    if len(paths) != 2:
        raise ConfigurationError(
            "configuration.bad_calibration", f"{len(paths)} files, one or two are wanted"
        )
    documents = [_document(path, _text(path)) for path in paths]
    if all(map(yaml_files.is_camera_info, documents)):
        return yaml_files.read_camera_infos((paths[0], documents[0]), (paths[1], documents[1]))
    if all(map(yaml_files.is_sensor, documents)):
        return yaml_files.read_sensors((paths[0], documents[0]), (paths[1], documents[1]))
    if all(map(yaml_files.is_opencv_stereo, documents)):
        both = dict(documents[0]) | dict(documents[1])
        return yaml_files.read_opencv_stereo(paths[0], both, size, length_m)
    raise ConfigurationError(
        "configuration.bad_calibration",
        f"{paths[0]} and {paths[1]}: two camera_info, two sensor.yaml with T_BS, or OpenCV's "
        "intrinsics and extrinsics are wanted",
    )


def read_eye(path: Path, size: tuple[int, int]) -> Pinhole:
    """One camera's lens for pictures of ``size`` (width, height): of a file of one camera, or the left eye of
    a stereo camera's. Raises ConfigurationError.
    """
    text = _text(path)
    if not _is_zed(path, text):
        document = _document(path, text)
        if yaml_files.is_camera_info(document):
            return yaml_files.camera_info_eye(path, document, size)
        if yaml_files.is_sensor(document):
            return yaml_files.sensor_eye(path, document)
    found = read_calibration(path, size)
    eye = found.left
    K = np.array([[eye.fx_px, 0.0, eye.cx_px], [0.0, eye.fy_px, eye.cy_px], [0.0, 0.0, 1.0]])
    return Pinhole(K, eye.lens, eye.distortion, (found.width_px, found.height_px), found.covariance)


def write_calibration(path: Path, calibration: StereoCalibration) -> None:
    """Write ``calibration`` to ``path`` in our own format; reading gives the very same numbers. Raises
    OSError.
    """
    document = calibration.model_dump(mode="json", exclude_none=True)
    lines = ['# A stereo camera as it comes: docs/camera.md, "A calibration file".']
    covariance = document.pop("covariance", None)
    lines.append(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120).rstrip())
    if covariance is not None:
        names = ", ".join(calibration.parameters)
        lines += [f"# rows and columns: {names}", "covariance:"]
        lines += [f"- [{', '.join(_shortest(value) for value in row)}]" for row in covariance]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _shortest(value: float) -> str:
    """A float that YAML reads back as the same float: its exponent needs a point and a sign."""
    text = repr(float(value))
    mantissa, _, exponent = text.partition("e")
    if not exponent:
        return text
    sign = exponent[0] if exponent[0] in "+-" else "+"
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{sign}{exponent.lstrip('+-')}"


def _is_zed(path: Path, text: str) -> bool:
    return text.lstrip().startswith("[") or path.suffix.lower() == ".conf"


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigurationError("configuration.unreadable", f"{path}: {error.strerror}") from error
    try:
        text = decoded(data[:_MOST_BYTES])
    except UnicodeDecodeError as error:
        why = f"{path}: no text at byte {error.start}; {_WANTED}"
        raise ConfigurationError("configuration.bad_calibration", why) from error
    if not text.strip():
        raise ConfigurationError("configuration.bad_calibration", f"{path}: is empty; {_WANTED}")
    return text


def _document(path: Path, text: str) -> Mapping[str, Any]:
    if text.startswith("%YAML:1.0") or "!!opencv-matrix" in text:
        return _file_storage(path, text)
    if "camera matrix" in text and "[image]" in text:
        why = f"{path}: an INI of ROS camera_calibration; its ost.yaml is read, or make one with"
        convert = "`camera_calibration_parsers convert FILE.ini FILE.yaml`"
        raise ConfigurationError("configuration.bad_calibration", f"{why} {convert}")
    return parse_mapping(_one_document(text), str(path))


def _one_document(text: str) -> str:
    """Without the dashes that ``ros2 topic echo`` puts between documents, where there is but one."""
    parts = [part for part in re.split(r"(?m)^---[^\S\n]*$", text) if part.strip()]
    return parts[0] if len(parts) == 1 else text


class _StorageLoader(yaml.SafeLoader):
    """Reads OpenCV's FileStorage, whose matrices carry a tag and whose first line is not YAML."""


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    if not isinstance(node, yaml.MappingNode):
        return None
    parts = loader.construct_mapping(node, deep=True)
    return parts.get("data")


_StorageLoader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def _file_storage(path: Path, text: str) -> Mapping[str, Any]:
    body = re.sub(r"^%YAML:1\.0[^\n]*\n(---[^\n]*\n)?", "", text)
    try:
        document = parse_yaml(body, f"{path}: no FileStorage of OpenCV", _StorageLoader)
    except ConfigurationError as error:
        raise ConfigurationError("configuration.bad_calibration", str(error)) from error
    if not isinstance(document, dict):
        raise ConfigurationError("configuration.bad_calibration", f"{path}: holds no names; {_WANTED}")
    return document
