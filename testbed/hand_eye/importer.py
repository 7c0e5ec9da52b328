"""Pose pairs from JSON and YAML files, docs/hand_eye.md; recordings in time are in ``trajectories``.

Whatever is wrong with a file is said in one line with the file, the sample and the offending value. Nothing
is repaired silently: quaternions far from unit norm are normalised only when that is asked for.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.configuration import parse_yaml
from foundation.foreign_text import parse_json
from protocol.errors import ConfigurationError, RequestRefused
from testbed.hand_eye.pose_text import (
    file_text,
    numbers,
    rotation_of_quaternion,
    rotation_of_vector,
    unit_scale,
)
from vision_pc.config.choices import Setup
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import CornerViews, PosePairs, distinct, pose_pairs
from vision_pc.core.se3 import Array

FORMAT = "longreach-hand-eye/1"
_OTHER_NAMES = {  # MoveIt's and easy_handeye's
    "effector_wrt_world": "hand",
    "object_wrt_sensor": "camera",
    "robot": "hand",
    "tracking": "camera",
}


class ImportOptions(NamedTuple):
    """``setup``, ``marker_id`` override the file's; ``camera_in_target`` inverts the camera's poses.

    ``normalise`` accepts quaternions of any norm, as printed tables need it.
    """

    setup: Setup | None = None
    marker_id: int | None = None
    camera_in_target: bool = False
    normalise: bool = False


def load(path: Path, options: ImportOptions | None = None) -> PosePairs:
    """The samples of a YAML (``.yaml``, ``.yml``) or JSON file, checked.

    Raises RequestRefused (``refused.hand_eye.…``) with file and sample for anything that cannot be believed.
    """
    options = options or ImportOptions()
    text = file_text(path)
    try:
        return _from_document(_document(text, path.suffix.lower() in (".yaml", ".yml")), options)
    except RequestRefused as error:
        raise RequestRefused(error.cause, f"{path.name}: {error}") from error


def _document(text: str, is_yaml: bool) -> Any:
    try:
        return parse_yaml(text, "not YAML") if is_yaml else parse_json(text)
    except (ValueError, ConfigurationError) as error:
        why = str(error) if is_yaml else f"not JSON: {error}"
        raise RequestRefused("refused.hand_eye.unreadable", why) from error


def _from_document(data: Any, options: ImportOptions) -> PosePairs:
    if isinstance(data, list):  # MoveIt's pose samples: [[hand in base, target in camera], ...] as 4×4
        data = {"samples": [_bare_pair(pair, k) for k, pair in enumerate(data)]}
    if not isinstance(data, dict) or not isinstance(data.get("samples"), list):
        has = f"has {', '.join(map(str, data))[:80]}; " if isinstance(data, dict) else ""
        why = f"{has}a list of pose pairs or an object with 'samples', each with hand and camera, is wanted"
        raise RequestRefused("refused.hand_eye.format", why)
    known = {
        "format", "setup", "length_unit", "marker_id", "samples",
        "camera_matrix", "distortion", "target_points_m",
    }  # fmt: skip
    _only(data, known, "the file")
    if data.get("format", FORMAT) != FORMAT:
        raise RequestRefused("refused.hand_eye.format", f"format is {data['format']!r}, known is {FORMAT!r}")
    unit = unit_scale(data.get("length_unit", "m"))
    setup = options.setup or _setup(data.get("setup", Setup.EYE_IN_HAND.value))
    wanted = options.marker_id if options.marker_id is not None else data.get("marker_id")
    names, hands, cameras, pixels = [], [], [], []
    for k, sample in enumerate(data["samples"]):
        name = str(sample.get("name", k + 1)) if isinstance(sample, dict) else str(k + 1)
        where = f"sample {name}"
        if not isinstance(sample, dict):
            raise RequestRefused(
                "refused.hand_eye.format", f"{where}: an object is wanted, got {type(sample).__name__}"
            )
        sample = {_OTHER_NAMES.get(key, key): part for key, part in sample.items()}
        _only(sample, {"name", "hand", "camera", "settled", "marker_id", "corners_px"}, where)
        _check_flags(sample.get("settled"), sample.get("marker_id"), wanted, where)
        hands.append(_pose(sample.get("hand"), f"{where}: hand", unit, options))
        cameras.append(_pose(sample.get("camera"), f"{where}: camera", unit, options))
        names.append(name)
        pixels.append(sample.get("corners_px"))
    return _pairs(hands, cameras, setup, names, options, _corners(data, pixels, names))


def _bare_pair(pair: Any, k: int) -> dict[str, Any]:
    if isinstance(pair, dict):
        return pair
    if not isinstance(pair, list) or len(pair) != 2:
        raise RequestRefused("refused.hand_eye.count", f"sample {k + 1}: a pair of poses is wanted")
    return {"hand": pair[0], "camera": pair[1]}


def _only(data: Mapping[str, Any], known: set[str], where: str) -> None:
    unknown = sorted(set(data) - known)
    if unknown:
        raise RequestRefused("refused.hand_eye.format", f"{where}: unknown key '{unknown[0]}'")


def _setup(name: Any) -> Setup:
    known = [setup.value for setup in Setup]
    if name not in known:
        raise RequestRefused("refused.hand_eye.format", f"setup is {name!r}, known are {', '.join(known)}")
    return Setup(name)


def _check_flags(settled: Any, marker_id: Any, wanted: Any, where: str) -> None:
    if settled is not None and not isinstance(settled, bool):
        why = f"{where}: settled = {settled!r}: true or false is wanted"
        raise RequestRefused("refused.hand_eye.format", why)
    if settled is False:
        raise RequestRefused("refused.hand_eye.unsettled", f"{where}: taken before the arm had settled")
    marker_ids = [numbers([one], 1, f"{where}: marker_id") for one in (wanted, marker_id) if one is not None]
    if len(marker_ids) == 2 and marker_ids[0] != marker_ids[1]:
        raise RequestRefused(
            "refused.hand_eye.marker_id", f"{where}: shows marker {marker_id}, marker {wanted} was asked for"
        )


def _pose(value: Any, where: str, unit: float, options: ImportOptions) -> Array:
    """One pose written as a 4×4 matrix or as position with quaternion, rotation vector or matrix."""
    if isinstance(value, dict) and "translation" in value:
        value = _ros_transform(value, where)
    if isinstance(value, dict):
        _only(value, {"p", "q_wxyz", "q_xyzw", "rotation_vector_rad", "rotation_vector_deg", "R"}, where)
        p = unit * numbers(value.get("p"), 3, f"{where} p")
        return se3.transform(_rotation(value, where, options), p)
    X = numbers(value, 16, where).reshape(4, 4)
    X[:3, 3] *= unit
    return X


def _ros_transform(value: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A transform of ROS under our keys: rotation x y z w."""
    _only(value, {"translation", "rotation"}, where)
    parts = {
        key: [part.get(axis) for axis in axes] if isinstance(part := value.get(key), dict) else part
        for key, axes in (("translation", "xyz"), ("rotation", "xyzw"))
    }
    return {"p": parts["translation"], "q_xyzw": parts["rotation"]}


def _rotation(value: Mapping[str, Any], where: str, options: ImportOptions) -> Array:
    given = sorted(set(value) - {"p"})
    if len(given) != 1:
        raise RequestRefused(
            "refused.hand_eye.format", f"{where}: exactly one rotation is wanted, got {given or 'none'}"
        )
    key = given[0]
    if key == "R":
        return numbers(value[key], 9, f"{where} R").reshape(3, 3)
    if key.startswith("q_"):
        q = numbers(value[key], 4, f"{where} {key}")
        return rotation_of_quaternion(q if key == "q_wxyz" else q[[3, 0, 1, 2]], where, options.normalise)
    v = numbers(value[key], 3, f"{where} {key}")
    return rotation_of_vector(np.radians(v) if key.endswith("_deg") else v, where)


def _corners(data: Mapping[str, Any], pixels: list[Any], names: list[str]) -> CornerViews | None:
    given = [p is not None for p in pixels]
    if not any(given):
        return None
    if not all(given):
        missing = names[given.index(False)]
        raise RequestRefused("refused.hand_eye.format", f"sample {missing}: corners_px is missing")
    points_m = data.get("target_points_m")
    if not isinstance(points_m, list) or not points_m:
        raise RequestRefused(
            "refused.hand_eye.format", "corners_px need target_points_m, a list of [x, y, z]"
        )
    points = np.stack([numbers(point, 3, f"target_points_m {k}") for k, point in enumerate(points_m, 1)])
    K = numbers(data.get("camera_matrix"), 9, "camera_matrix").reshape(3, 3)
    seen = np.empty((len(names), len(points), 2))
    for k, (name, value) in enumerate(zip(names, pixels, strict=True)):
        where = f"sample {name}: corners_px"
        if not isinstance(value, list) or len(value) != len(points):
            raise RequestRefused("refused.hand_eye.format", f"{where}: {len(points)} pixels are wanted")
        seen[k] = [[np.nan] * 2 if pixel is None else numbers(pixel, 2, where) for pixel in value]
    given = data.get("distortion", [0.0] * 5)
    distortion = numbers(given, len(given) if isinstance(given, list) else 5, "distortion")
    return CornerViews(points, seen, K, distortion)


def _pairs(
    hands: list[Array],
    cameras: list[Array],
    setup: Setup,
    names: list[str],
    options: ImportOptions,
    corners: CornerViews | None = None,
) -> PosePairs:
    X_CP = np.stack(cameras) if cameras else np.zeros((0, 4, 4))
    X_BT = np.stack(hands) if hands else np.zeros((0, 4, 4))
    if options.camera_in_target:
        X_CP = stacks.inverse(X_CP)
    own = (
        distinct(X_BT, X_CP) if all(np.isfinite(X).all() for X in (X_BT, X_CP)) else np.ones(len(X_BT), bool)
    )
    corners = corners and corners._replace(pixels=corners.pixels[own])
    pairs = pose_pairs(X_BT[own], X_CP[own], setup, tuple(np.array(names, dtype=object)[own]), corners)
    return replace(pairs, copies=len(names) - len(pairs))
