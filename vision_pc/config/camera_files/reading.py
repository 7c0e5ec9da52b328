"""Reads any calibration file of a stereo camera, told by what is in it, and writes our own."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from foundation.configuration import read_yaml
from protocol.errors import ConfigurationError
from vision_pc.config.camera_files import yaml_files
from vision_pc.config.camera_files.parts import made
from vision_pc.config.camera_files.zed import read_zed
from vision_pc.config.stereo_camera import StereoCalibration

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
    if text.lstrip("\ufeff \r\n\t").startswith("[") or path.suffix.lower() == ".conf":
        if size is None:
            raise ConfigurationError(
                "configuration.calibration_size",
                f"{path}: a ZED file holds several picture sizes: give --size WIDTHxHEIGHT of one eye",
            )
        return read_zed(path, text.lstrip("\ufeff"), size)
    document = _document(path, text)
    if "format" in document:
        return made(path, document)
    if yaml_files.is_kalibr(document):
        return yaml_files.read_kalibr(path, document)
    if yaml_files.is_camera_info(document):
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
    if all(map(yaml_files.is_opencv_stereo, documents)):
        both = dict(documents[0]) | dict(documents[1])
        return yaml_files.read_opencv_stereo(paths[0], both, size, length_m)
    raise ConfigurationError(
        "configuration.bad_calibration",
        f"{paths[0]} and {paths[1]}: two camera_info, or OpenCV's intrinsics and extrinsics, are wanted",
    )


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


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigurationError("configuration.unreadable", f"{path}: {error.strerror}") from error
    try:
        text = data[:_MOST_BYTES].decode("utf-8")
    except UnicodeDecodeError as error:
        why = f"{path}: no text at byte {error.start}; {_WANTED}"
        raise ConfigurationError("configuration.bad_calibration", why) from error
    if not text.strip():
        raise ConfigurationError("configuration.bad_calibration", f"{path}: is empty; {_WANTED}")
    return text


def _document(path: Path, text: str) -> Mapping[str, Any]:
    if text.startswith("%YAML:1.0") or "!!opencv-matrix" in text:
        return _file_storage(path, text)
    return read_yaml(path)


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
        document = yaml.load(body, Loader=_StorageLoader)  # a SafeLoader with one tag more
    except yaml.YAMLError as error:
        why = f"{path}: no FileStorage of OpenCV: {' '.join(str(error).split())}"
        raise ConfigurationError("configuration.bad_calibration", why) from error
    if not isinstance(document, dict):
        raise ConfigurationError("configuration.bad_calibration", f"{path}: holds no names; {_WANTED}")
    return document
