"""`longreach recording pictures`: stereo pictures of a ROS bag as directories that every reader takes."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from protocol.errors import ConfigurationError
from vision_pc.core.perception.pixel_formats import MOSAIC_TO_GREY
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image
from vision_pc.shell.cameras.picture_files import EyeFiles, eye_files

EYES = ("left", "right")
CALIBRATION = "calibration.yaml"
_RAW, _COMPRESSED, _INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
_BAYER = {f"bayer_{name}8": MOSAIC_TO_GREY[name[:2].upper()] for name in ("rggb", "bggr", "gbrg", "grbg")}
_GREY: dict[str, int | None] = dict.fromkeys(("mono8", "8UC1"), None) | {
    "rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY, "8UC3": cv2.COLOR_BGR2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY, "bgra8": cv2.COLOR_BGRA2GRAY, **_BAYER,
}  # fmt: skip
_ALIKE = 1e-3  # of a focal length, or rad: what rectification leaves
_FROM_S = 1_000_000_000  # 2001: an earlier stamp is no time of a clock that is set


class Extracted(NamedTuple):
    """The topics taken (left, right), the pairs that their pictures make, and the calibration, if written."""

    topics: tuple[str, str]
    pairs: EyeFiles
    calibration: Path | None


def extract_pictures(
    bag: Path, wanted: tuple[str | None, str | None], target: Path, report: Callable[[float], None]
) -> Extracted:
    """Write the pictures of both eyes, named by their stamps, to ``left`` and ``right`` in ``target``.

    ``bag``: of ROS 2 (a directory, .mcap or .db3) or ROS 1. ``wanted``: topics, None: the one picture topic
    with the eye in its name. Eyes whose CameraInfo is of rectified ones get ``calibration.yaml``. ``report``
    hears the share that is done. Raises ConfigurationError for what is no bag, has not these topics, or whose
    eyes no stamps bring together.
    """
    with _opened(bag) as reader:
        connections = [
            _chosen(bag, reader.connections, eye, topic) for eye, topic in zip(EYES, wanted, strict=True)
        ]
        taken = [(eye, one) for eye, one in zip(EYES, connections, strict=True)]
        total = sum(one.msgcount for one in connections)
        for number, (eye, message) in enumerate(_messages(bag, reader, taken)):
            path = target / eye / f"{_stamp_of(bag, eye, message)}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            if not cv2.imwrite(str(path), grey(message, f"{bag}: {eye} eye")):
                raise ConfigurationError("configuration.unwritable", f"{path}: cannot be written")
            report((number + 1) / max(total, 1))
        calibration, why = _write_calibration(bag, reader, connections, target)
    left, right = connections[0].topic, connections[1].topic
    pairs = eye_files(target / "left", target / "right", 1.0)
    return Extracted((left, right), pairs._replace(notes=(*pairs.notes, *why)), calibration)


def grey(message: Any, where: str) -> Image:
    """The picture (height, width) of a ``sensor_msgs`` Image or CompressedImage in grey.

    Raises ConfigurationError for an encoding of other than 8 bits, and data of another size.
    """
    data = np.asarray(message.data, dtype=np.uint8)
    if hasattr(message, "format"):
        picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise _bad(f"{where}: compressed as {message.format!r}, which is no picture")
        return np.asarray(picture, dtype=np.uint8)
    if message.encoding not in _GREY:
        raise _bad(f"{where}: encoding {message.encoding!r}, known are {', '.join(_GREY)}")
    channels = _CHANNELS.get(message.encoding, 1)
    if data.size != message.height * message.step or message.step < message.width * channels:
        size = f"{message.width} x {message.height} in rows of {message.step}"
        raise _bad(f"{where}: {data.size} bytes for {size} of {message.encoding}")
    rows = data.reshape(message.height, message.step)[:, : message.width * channels]
    picture = rows.reshape(message.height, message.width, channels) if channels > 1 else rows
    code = _GREY[message.encoding]
    return np.asarray(picture if code is None else cv2.cvtColor(picture, code), dtype=np.uint8)


@contextlib.contextmanager
def _opened(bag: Path) -> Iterator[AnyReader]:
    try:
        with AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except (AnyReaderError, OSError, AssertionError, ValueError) as error:
        raise _bad(f"{bag}: no bag of ROS that can be read: {error}") from error


def _chosen(bag: Path, connections: Sequence[Connection], eye: str, wanted: str | None) -> Connection:
    """The connection of an eye's pictures. Raises ConfigurationError."""
    pictures = {one.topic: one for one in connections if one.msgtype in (_RAW, _COMPRESSED)}
    listed = ", ".join(sorted(pictures)) or "none"
    if wanted is not None:
        if wanted in pictures:
            return pictures[wanted]
        others = {one.topic: one.msgtype for one in connections}
        what = f"is of {others[wanted]}" if wanted in others else "is not in it"
        raise _bad(f"{bag}: {wanted} {what}; topics of pictures: {listed}")
    named = [one for topic, one in pictures.items() if eye in topic.lower()]
    if len(named) != 1:
        several = f"{len(named)} topics of pictures have {eye!r} in their names"
        raise _bad(f"{bag}: {several}: name one with --{eye}; topics of pictures: {listed}")
    return named[0]


def _messages(
    bag: Path, reader: AnyReader, taken: Sequence[tuple[str, Connection]]
) -> Iterator[tuple[str, Any]]:
    for eye, connection in taken:
        if connection.msgcount == 0:
            raise _bad(f"{bag}: {connection.topic} has no message")
        for one, _, data in reader.messages(connections=[connection]):
            yield eye, reader.deserialize(data, one.msgtype)


def _stamp_of(bag: Path, eye: str, message: Any) -> str:
    stamp = message.header.stamp
    if stamp.sec < _FROM_S:
        raise _bad(
            f"{bag}: a picture of the {eye} eye is stamped {stamp.sec} s, no time of a clock that is set"
        )
    return f"{stamp.sec}.{stamp.nanosec:09d}"


def _write_calibration(
    bag: Path, reader: AnyReader, connections: Sequence[Connection], target: Path
) -> tuple[Path | None, list[str]]:
    """The rectified pair's lens, from both CameraInfo beside the pictures' topics; None, and why, where one
    is not there, or is not of a rectified camera.
    """
    infos: list[Any] = []
    for one in connections:
        beside = f"{one.topic.removesuffix('/compressed').rpartition('/')[0]}/camera_info"
        known = [each for each in reader.connections if (each.topic, each.msgtype) == (beside, _INFO)]
        found = next(reader.messages(connections=known), None) if known else None
        if found is None:
            return None, [f"no calibration is written: there is no {beside}"]
        infos.append(reader.deserialize(found[2], _INFO))
    left, right = (np.asarray(info.p, dtype=float).reshape(3, 4) for info in infos)
    if why := _not_rectified(infos, left, right):
        P = f"their P has fx {left[0, 0]:g}, fx times the baseline {left[0, 3] - right[0, 3]:g}"
        return None, [f"no calibration is written: {why}, so that these may be raw pictures; {P}"]
    values = {
        "fx_px": left[0, 0], "fy_px": left[1, 1], "cx_px": left[0, 2], "cy_px": left[1, 2],
        "right_cx_px": right[0, 2], "baseline_m": (left[0, 3] - right[0, 3]) / left[0, 0],
    }  # fmt: skip
    sizes = {"width_px": int(infos[0].width), "height_px": int(infos[0].height)}
    path = target / CALIBRATION
    path.write_text(yaml.safe_dump({name: float(value) for name, value in values.items()} | sizes))
    return path, []


def _not_rectified(infos: Sequence[Any], left: Array, right: Array) -> str:
    """What two CameraInfo with projections ``left`` and ``right`` (3, 4) have that no rectified pair has.

    The name of a topic tells nothing: image_proc publishes the raw camera's beside rectified pictures too.
    """
    for eye, info, P in zip(EYES, infos, (left, right), strict=True):
        K, R = (np.asarray(part, dtype=float).reshape(3, 3) for part in (info.k, info.r))
        if np.any(info.d):
            return f"CameraInfo of the {eye} eye has distortion"
        if not np.allclose(R, np.eye(3), atol=_ALIKE):
            return f"CameraInfo of the {eye} eye turns it (R is not 1)"
        if not (P[0, 0] > 0.0 and np.allclose(K, P[:, :3], rtol=_ALIKE, atol=_ALIKE)):
            return f"CameraInfo of the {eye} eye has another K than P"
    if not np.allclose(left[[0, 1, 1], [0, 1, 2]], right[[0, 1, 1], [0, 1, 2]], rtol=_ALIKE):
        return "both eyes' P differ in fx, fy or cy"
    return ""


def _bad(words: str) -> ConfigurationError:
    return ConfigurationError("configuration.bad_bag", words)
