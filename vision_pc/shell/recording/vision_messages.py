"""The vision PC's messages: what was measured in which frame, with a digest of all of it, and references."""

import json
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from foundation.recording.messages import MessageField, message_class
from protocol.pose import Pose
from protocol.reference_messages import Command, ReferencePath, ReferencePose, Request, StreamedPose
from vision_pc.core.buffers import digest
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraErrors, FrameObservation, Look, OdometryPose, StereoPair

_AXES = ("x", "y", "z")


def _place(name: str) -> list[MessageField]:
    return [MessageField(f"p_{name}_{axis}_m") for axis in _AXES]


def _several(*names: str, kind: str = "double") -> list[MessageField]:
    return [MessageField(name, kind, repeated=True) for name in names]


def _integers(*names: str) -> list[MessageField]:
    return [MessageField(name, "int64") for name in names]


_OFFSET = tuple(f"offset_{name}_px" for name in ("x", "y", "std_x", "std_y"))
_MISPLACED = ("misplaced_marker", "misplaced_off_m", "misplaced_std_m")

FrameMessage = message_class(
    "Frame", [*_integers("frame_id", "capture_ns", "width", "height", "crc_left", "crc_right")]
)
ObservationMessage = message_class(
    "Observation",
    [
        *_integers("number", "frame_id", "capture_ns", "previous"),
        MessageField("corrected", "bool"),
        MessageField("digest", "string"),
        *_place("CM"),
        *_place("CO"),
        *_several("X_CM", "X_CO", "cov_CM", "cov_CO"),
        *_several("marker_ids", kind="int64"),
        *_several("corners_left_px", "corners_right_px", "marker_residuals_px"),
        *map(MessageField, _OFFSET),
        MessageField("missing_tool", "string"),
        MessageField("missing_object", "string"),
        MessageField("rejected_json", "string"),
        *_integers("since_full_search"),
    ],
)
OdometryStartMessage = message_class(
    "OdometryStart", [*_integers("odometry", "previous", "capture_ns"), MessageField("corrected", "bool")]
)
OdometryMessage = message_class(
    "Odometry",
    [
        *_integers("odometry", "frame_id", "capture_ns"),
        MessageField("tool_given", "bool"),
        MessageField("digest", "string"),
        MessageField("lost", "string"),
        *_place("C0C"),
        *_several("X_C0C", "covariance"),
        *_integers("inliers"),
        MessageField("coverage"),
        MessageField("residual_px"),
        *_several("X_BT"),
    ],
)
CameraErrorsMessage = message_class(
    "CameraErrors",
    [
        *_several("captures_ns", kind="int64"),
        MessageField("digest", "string"),
        *_several("values", "covariance"),
    ],
)
LookMessage = message_class(
    "Look",
    [
        *_integers("time_ns"),
        *_several("observations", kind="int64"),
        MessageField("digest", "string"),
        *_place("CM"),
        *_place("CO"),
        *_several("X_CM", "X_CO", "X_BT", "cov_CM", "cov_CO", "frame_cov_CM", "frame_cov_CO"),
        *_integers("frames", "failed_tool", "failed_object"),
        *map(MessageField, _OFFSET),
        *_integers("misplaced_marker"),
        *_several("misplaced_off_m", "misplaced_std_m"),
    ],
)
ReferenceMessage = message_class(
    "Reference",
    [
        *_integers("number"),
        MessageField("kind", "string"),
        MessageField("command", "string"),
        *_several("p_m", "q_wxyz", "twist"),
        MessageField("duration_s"),
        MessageField("segment_s"),
        MessageField("dwell_s"),
        *_integers("measured_ns", "stream"),
    ],
)
ClockMessage = message_class("Clock", [*_integers("offset_ns", "uncertainty_ns")])


def frame_bytes(pair: StereoPair) -> bytes:
    """longreach.Frame with the CRC-32 of each eye's pixels."""
    height, width = pair.left.shape
    crcs = {f"crc_{eye}": checksum(getattr(pair, eye)) for eye in ("left", "right")}
    rest = FrameMessage(
        frame_id=pair.frame_id, capture_ns=pair.capture_ns, width=width, height=height, **crcs
    )
    return bytes(rest.SerializeToString())


def checksum(pixels: Any) -> int:
    """CRC-32 of a picture, row by row."""
    return zlib.crc32(np.ascontiguousarray(pixels).data)


def observation_bytes(number: int, previous: int | None, corrected: bool, seen: FrameObservation) -> bytes:
    """longreach.Observation ``number``; ``digest`` is of everything measured, also what has no field.

    ``previous``: the number of the one that it went on from, None without one, -1 for one that is not known;
    ``corrected``: whether camera errors had been put into that since.
    """
    markers = seen.markers
    nowhere = np.full((4, 2), np.nan)
    rights = [nowhere if marker.corners_right is None else marker.corners_right for marker in markers]
    return _filled(
        ObservationMessage,
        number=number,
        frame_id=seen.frame_id,
        capture_ns=seen.capture_ns,
        previous=previous,
        corrected=corrected,
        digest=digest(seen),
        **_position_fields("CM", seen.X_CM),
        **_position_fields("CO", seen.X_CO),
        **{name: getattr(seen, name) for name in ("X_CM", "X_CO", "cov_CM", "cov_CO")},
        marker_ids=[marker.marker_id for marker in markers],
        corners_left_px=_flat([marker.corners_left for marker in markers]),
        corners_right_px=_flat(rights),
        marker_residuals_px=[marker.residual_px for marker in markers],
        **({} if seen.offset is None else dict(zip(_OFFSET, seen.offset, strict=True))),
        missing_tool=seen.missing_tool,
        missing_object=seen.missing_object,
        rejected_json=json.dumps(seen.rejected, sort_keys=True) if seen.rejected else None,
        since_full_search=seen.since_full_search,
    )


def start_bytes(odometry: int, previous: int | None, corrected: bool, capture_ns: int) -> bytes:
    """longreach.OdometryStart: number ``odometry`` begins after observation ``previous``, which is as in
    ``observation_bytes``.
    """
    start = {"odometry": odometry, "previous": previous, "corrected": corrected, "capture_ns": capture_ns}
    return _filled(OdometryStartMessage, **start)


def tracked_bytes(
    odometry: int, frame: tuple[int, int], tool_given: bool, X_BT: Array | None, pose: OdometryPose | str
) -> bytes:
    """longreach.Odometry: the pose in the ``frame`` of that id and capture time, or why it is lost; whether
    the tool's marker was given, and the arm's state.
    """
    stamp: dict[str, Any] = {"odometry": odometry, "frame_id": frame[0], "capture_ns": frame[1]}
    stamp |= {"tool_given": tool_given, "X_BT": X_BT}
    if isinstance(pose, str):
        return _filled(OdometryMessage, **stamp, digest=digest(pose), lost=pose)
    measured = ("covariance", "inliers", "coverage", "residual_px")
    return _filled(
        OdometryMessage,
        **stamp,
        digest=digest(pose),
        **_position_fields("C0C", pose.X_C0C),
        X_C0C=pose.X_C0C,
        **{name: getattr(pose, name) for name in measured},
    )


def fitted_bytes(captures_ns: Sequence[int], errors: CameraErrors | None) -> bytes:
    """longreach.CameraErrors by the samples of these captures; without values where they told too little."""
    found = {} if errors is None else errors._asdict()
    return _filled(CameraErrorsMessage, captures_ns=captures_ns, digest=digest(errors), **found)


def look_bytes(look: Look, observations: Sequence[int]) -> bytes:
    """longreach.Look, and the numbers of its observations; -1 for one that is not known."""
    misplaced = look.misplaced
    fields = {name: value for name, value in look._asdict().items() if name not in ("offset", "misplaced")}
    doubt = None if misplaced is None else zip(_MISPLACED, misplaced, strict=True)
    return _filled(
        LookMessage,
        observations=observations,
        digest=digest(look),
        **_position_fields("CM", look.X_CM),
        **_position_fields("CO", look.X_CO),
        **({} if look.offset is None else dict(zip(_OFFSET, look.offset, strict=True))),
        **dict(doubt or ()),
        **fields,
    )


def reference_bytes(number: int, request: Request | StreamedPose) -> bytes:
    """longreach.Reference: what was asked of the controller, all its poses in B one after another."""
    kind = type(request).__name__
    match request:
        case Command():
            rest: dict[str, Any] = {"command": request.code.name}
        case ReferencePose():
            pose, duration_s = request.X_BT_ref, request.duration_s
            return _filled(
                ReferenceMessage, number=number, kind=kind, **_poses([pose]), duration_s=duration_s
            )
        case ReferencePath():
            rest = {"segment_s": request.segment_s, "dwell_s": request.dwell_s}
        case StreamedPose():
            rest = {"measured_ns": request.time_ns, "stream": request.stream_id, "twist": request.twist_ref}
    return _filled(ReferenceMessage, number=number, kind=kind, **_poses(poses_of(request)), **rest)


def clock_bytes(offset: tuple[int, int]) -> bytes:
    """longreach.Clock: the controller's clock minus the vision PC's, and how far that may be off."""
    return _filled(ClockMessage, offset_ns=offset[0], uncertainty_ns=offset[1])


def poses_of(request: Request | StreamedPose) -> tuple[Pose, ...]:
    """The poses of T in B that a request names, in order."""
    if isinstance(request, ReferencePath):
        return request.waypoints
    return () if isinstance(request, Command) else (request.X_BT_ref,)


def _poses(poses: Sequence[Pose]) -> dict[str, list[float]]:
    return {"p_m": _flat([pose.p_m for pose in poses]), "q_wxyz": _flat([pose.q_wxyz for pose in poses])}


def _position_fields(name: str, X: Array | None) -> dict[str, float]:
    """The position of ``X`` in fields of its own, for plots."""
    return {} if X is None else {f"p_{name}_{axis}_m": float(X[i, 3]) for i, axis in enumerate(_AXES)}


def _flat(parts: Sequence[Any]) -> list[float]:
    return [] if len(parts) == 0 else np.ravel(np.asarray(parts, dtype=np.float64)).tolist()


def _filled(message: Any, **values: Any) -> bytes:
    """A message with what is there; matrices row by row."""
    given = {name: value for name, value in values.items() if value is not None}
    arrays = {name: value.ravel().tolist() for name, value in given.items() if isinstance(value, np.ndarray)}
    return bytes(message(**{**given, **arrays}).SerializeToString())
