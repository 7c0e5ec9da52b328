"""Reads any calibration file of a stereo camera, told by what is in it, and writes our own."""

import configparser
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import yaml

from foundation.configuration import parse_mapping, parse_yaml
from foundation.foreign_text import decoded, unreadable
from foundation.numbers_as_written import StrictLoader
from protocol.errors import ConfigurationError
from vision_pc.config.camera_files import yaml_files
from vision_pc.config.camera_files.parts import Entries, Pinhole, assembled, bad_calibration, believed, made
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
    text = text_of(path)
    if _is_zed(path, text):
        return _read_zed(path, text, size)
    document = _document(path, text)
    file = Entries(path, document)
    if "format" in document:
        return made(path, document)
    if "cam0" in document:
        return yaml_files.read_kalibr(file)
    if yaml_files.is_camera_info(document) or yaml_files.is_sensor(document):
        why = "is the file of one eye, both are wanted: longreach camera convert LEFT RIGHT --out FILE"
        raise bad_calibration(path, why)
    if {"Camera1.fx", "Stereo.T_c1_c2"} <= set(document):
        return yaml_files.read_orb_slam(file)
    if yaml_files.is_opencv_stereo(document):
        return yaml_files.read_opencv_stereo(file, size, length_m)
    keys = ", ".join(str(key) for key in document)[:80] or "nothing"
    raise bad_calibration(path, f"has {keys}; {_WANTED}")


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
    left, right = (Entries(path, _document(path, text_of(path))) for path in paths)
    documents = (left.values, right.values)
    if all(map(yaml_files.is_camera_info, documents)):
        return yaml_files.read_camera_infos(left, right)
    if all(map(yaml_files.is_sensor, documents)):
        return yaml_files.read_sensors(left, right)
    if all(map(yaml_files.is_opencv_stereo, documents)):
        both = Entries(paths[0], {**left.values, **right.values})
        return yaml_files.read_opencv_stereo(both, size, length_m)
    why = "two camera_info, two sensor.yaml with T_BS, or OpenCV's intrinsics and extrinsics are wanted"
    raise ConfigurationError("configuration.bad_calibration", f"{paths[0]} and {paths[1]}: {why}")


def read_eye(path: Path, size: tuple[int, int]) -> Pinhole:
    """One camera's lens for pictures of ``size`` (width, height): of a file of one camera, or the left eye of
    a stereo camera's. Raises ConfigurationError.
    """
    text = text_of(path)
    if not _is_zed(path, text):
        file = Entries(path, _document(path, text))
        if yaml_files.is_camera_info(file.values):
            return believed(yaml_files.camera_info_eye(file, size), path)
        if yaml_files.is_sensor(file.values):
            return believed(yaml_files.kalibr_eye(file), path)
    found = read_calibration(path, size)
    eye = found.left
    K = np.array([[eye.fx_px, 0.0, eye.cx_px], [0.0, eye.fy_px, eye.cy_px], [0.0, 0.0, 1.0]])
    return Pinhole(K, eye.lens, eye.distortion, (found.width_px, found.height_px))


def write_calibration(path: Path, calibration: StereoCalibration) -> None:
    """Write ``calibration`` to ``path`` in our own format; reading gives the very same numbers. Raises
    OSError.
    """
    document = calibration.model_dump(mode="json", exclude_none=True)
    content = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120)
    heading = '# A stereo camera as it comes: docs/camera.md, "A calibration file".\n'
    path.write_text(heading + content, encoding="utf-8")


def _is_zed(path: Path, text: str) -> bool:
    return text.lstrip().startswith("[") or path.suffix.lower() == ".conf"


def _read_zed(path: Path, text: str, size: tuple[int, int] | None) -> StereoCalibration:
    """The calibration of a ZED's factory file for pictures of ``size`` (width, height) an eye."""
    if size not in RESOLUTIONS:
        known = ", ".join(f"{name} {w}x{h}" for (w, h), name in RESOLUTIONS.items())
        why = "a ZED file holds several picture sizes: give --size WIDTHxHEIGHT of one eye"
        if size is not None:
            why = f"no ZED takes pictures of {size[0]}x{size[1]} px an eye; known: {known}"
        raise ConfigurationError("configuration.calibration_size", f"{path}: {why}")
    sections = configparser.ConfigParser(strict=True, interpolation=None, inline_comment_prefixes=("#", ";"))
    try:
        sections.read_string(text)
    except configparser.Error as error:
        raise bad_calibration(path, f"no ZED file: {' '.join(str(error).split())}") from error
    mode = RESOLUTIONS[size]
    known = ", ".join(sections.sections()) or "no section"
    names = ("STEREO", f"LEFT_CAM_{mode}", f"RIGHT_CAM_{mode}")
    for name in names:
        if name not in sections:
            why = f"pictures of {size[0]}x{size[1]} px are wanted; the file has {known}"
            raise Entries(path, {}).missing(f"[{name}]", why)
    stereo, *cameras = (Entries(path, sections[name], f"[{name}] ") for name in names)
    lenses = []
    for side, camera in zip(("LEFT", "RIGHT"), cameras, strict=True):  # newer files have the lenses apart
        apart = f"{side}_DISTO"
        is_apart = apart in sections and "k1" not in camera.values
        lenses.append(Entries(path, sections[apart], f"[{apart}] ") if is_apart else camera)
    kinds = [_zed_lens(lens, other) for lens, other in (lenses, lenses[::-1])]
    eyes = [Pinhole(camera.pinhole(("fx", "fy", "cx", "cy")), *lens, size)
            for camera, lens in zip(cameras, kinds, strict=True)]  # fmt: skip
    turn = [_of_resolution(stereo, key, mode, "radians") for key in ("RX", "CV", "RZ")]
    shift = [-stereo.number("Baseline"), 0.0, 0.0]
    if any(
        name in stereo.values for key in ("TY", "TZ") for name in (f"{key}_{mode}", key)
    ):  # older files: neither
        shift[1:] = [_of_resolution(stereo, key, mode, "mm") for key in ("TY", "TZ")]
    R = np.asarray(cv2.Rodrigues(np.array(turn))[0], dtype=np.float64)
    return assembled(path, f"{path.name} [{mode}], ZED factory file", eyes, R, 1e-3 * np.array(shift))


def _of_resolution(stereo: Entries, key: str, mode: str, unit: str) -> float:
    """A turn or shift of this resolution; CV and its like without one are of all resolutions."""
    expected = f"{unit}; a file of another resolution cannot be used"
    return stereo.number(f"{key}_{mode}", stereo.entry(expected, f"{key}_{mode}", key))


def _zed_lens(lens: Entries, other: Entries) -> tuple[LensModel, tuple[float, ...]]:
    """One eye's coefficients; one that either eye has is wanted of both."""
    if "k4" in lens.values and "p1" not in lens.values:
        values = [lens.number(key) for key in COEFFICIENTS[LensModel.FISHEYE]]
        return lens.lens("k1 …", "fisheye", values)
    names = COEFFICIENTS[LensModel.RATIONAL]
    given = [key in lens.values or key in other.values for key in names]
    found = [lens.number("k1")]
    for k, key in enumerate(names[1:], 1):  # of k1 k2 p1 p2 k3 none is left out before another
        found.append(lens.number(key) if given[k] or any(given[k:5]) else 0.0)
    thin_prism = [lens.number(key) for key in ("s1", "s2", "s3", "s4") if key in lens.values]
    return lens.lens("k1 …", "pinhole", [*found, *thin_prism, *[0.0] * (4 - len(thin_prism))])


def text_of(path: Path) -> str:
    """What is in the file. Raises ConfigurationError where it is no text, or empty."""
    try:
        text = decoded(path.read_bytes()[:_MOST_BYTES])
    except OSError as error:
        raise ConfigurationError("configuration.unreadable", f"{path}: {unreadable(error)}") from error
    except UnicodeDecodeError as error:
        raise bad_calibration(path, f"{unreadable(error)}; {_WANTED}") from error
    if not text.strip():
        raise bad_calibration(path, f"is empty; {_WANTED}")
    return text


def _document(path: Path, text: str) -> Mapping[str, Any]:
    if text.startswith("<?xml"):
        return _xml_storage(path, text)
    if text.startswith("%YAML:1.0") or "!!opencv-matrix" in text:
        return _file_storage(path, text)
    if "camera matrix" in text and "[image]" in text:
        why = "an INI of ROS camera_calibration; its ost.yaml is read, or make one with"
        raise bad_calibration(path, f"{why} `camera_calibration_parsers convert FILE.ini FILE.yaml`")
    parts = [part for part in re.split(r"(?m)^---[^\S\n]*$", text) if part.strip()]
    messages = [parse_mapping(part, str(path)) for part in parts]
    first, *others = [{**message, "header": None} for message in messages]
    if any(other != first for other in others):
        raise bad_calibration(path, f"{len(messages)} messages that differ, one is wanted")
    return messages[0]


class _StorageLoader(StrictLoader):
    """Reads OpenCV's FileStorage, whose matrices carry a tag and whose first line is not YAML."""


_StorageLoader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix",
    lambda loader, node: (
        loader.construct_mapping(node, deep=True) if isinstance(node, yaml.MappingNode) else None
    ),
)


def _file_storage(path: Path, text: str) -> Mapping[str, Any]:
    body = re.sub(r"^%YAML:1\.0[^\n]*\n(---[^\n]*\n)?", "", text)
    try:
        document = parse_yaml(body, f"{path}: no FileStorage of OpenCV", _StorageLoader)
    except ConfigurationError as error:
        raise ConfigurationError("configuration.bad_calibration", str(error)) from error
    if not isinstance(document, dict):
        raise bad_calibration(path, f"holds no names; {_WANTED}")
    return document


def _xml_storage(path: Path, text: str) -> Mapping[str, Any]:
    """OpenCV's FileStorage in XML, its matrices as in YAML."""
    try:
        if "<!" in text.replace("<!--", ""):
            raise ElementTree.ParseError("it defines entities")
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise bad_calibration(path, f"no FileStorage of OpenCV: {error}") from error
    found: dict[str, Any] = {}
    for node in root:
        if node.tag in found:
            raise bad_calibration(path, f"{node.tag} is written twice")
        found[node.tag] = {part.tag: (part.text or "").strip() for part in node} or (node.text or "").strip()
        if node.get("type_id") == "opencv-matrix":
            found[node.tag]["data"] = found[node.tag].get("data", "").split()
    return found
