"""What is recorded as Protobuf: well-known schemas that viewers draw, and flat messages made from a table."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from foundation.recording.mcap_file import Format

Array = NDArray[np.float64]
LEVELS = {"info": Log.Level.INFO, "warning": Log.Level.WARNING, "error": Log.Level.ERROR}

_Kind = descriptor_pb2.FieldDescriptorProto
_KINDS = {
    "double": _Kind.TYPE_DOUBLE,
    "int64": _Kind.TYPE_INT64,
    "uint64": _Kind.TYPE_UINT64,
    "bool": _Kind.TYPE_BOOL,
    "string": _Kind.TYPE_STRING,
    "bytes": _Kind.TYPE_BYTES,
}


class MessageField(NamedTuple):
    """One field of a message of our own. ``kind``: double, int64, uint64, bool, string or bytes.

    ``repeated``: any number of them; otherwise its absence can be told from zero.
    """

    name: str
    kind: str = "double"
    repeated: bool = False


class PosedFrame(NamedTuple):
    """A frame in a tree of frames: ``child`` has pose ``X`` (4, 4) in ``parent``."""

    parent: str
    child: str
    X: Array


def message_class(name: str, fields: Sequence[MessageField]) -> Any:
    """The Protobuf class ``longreach.name`` with these fields, numbered from 1 in their order."""
    file = descriptor_pb2.FileDescriptorProto(
        name=f"longreach/{name}.proto", package="longreach", syntax="proto3"
    )
    message = file.message_type.add(name=name)
    for number, field in enumerate(fields, 1):
        made = message.field.add(name=field.name, number=number, type=_KINDS[field.kind])
        made.label = _Kind.LABEL_REPEATED if field.repeated else _Kind.LABEL_OPTIONAL
        if not field.repeated:
            made.proto3_optional = True
            made.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{field.name}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"longreach.{name}"))


EventMessage = message_class(
    "Event", (MessageField("event", "string"), MessageField("fields_json", "string"))
)


def event_bytes(said: Mapping[str, Any]) -> bytes:
    """longreach.Event of ``event`` and whatever else ``said`` holds."""
    rest = {name: value for name, value in said.items() if name != "event"}
    text = json.dumps(rest, separators=(",", ":"), default=str)
    return bytes(EventMessage(event=said["event"], fields_json=text).SerializeToString())


def fields_of(data: bytes) -> dict[str, Any]:
    """What ``event_bytes`` was given."""
    said = EventMessage.FromString(data)
    fields: dict[str, Any] = json.loads(said.fields_json)
    return {"event": said.event} | fields


def format_of(message: Any) -> Format:
    """The format of messages of a Protobuf class: its schema is all files that it needs."""
    files: dict[str, Any] = {}

    def gather(descriptor: Any) -> None:
        if descriptor.name not in files:
            for needed in descriptor.dependencies:
                gather(needed)
            files[descriptor.name] = descriptor

    gather(message.DESCRIPTOR.file)
    described = descriptor_pb2.FileDescriptorSet()
    for descriptor in files.values():
        descriptor.CopyToProto(described.file.add())
    name = message.DESCRIPTOR.full_name
    return Format(name, "protobuf", described.SerializeToString(deterministic=True), "protobuf")


def put_time(stamp: Any, time_ns: int) -> None:
    """Set a Timestamp of Protobuf."""
    stamp.seconds, stamp.nanos = divmod(time_ns, 1_000_000_000)


def put_pose(pose: Any, X: Array) -> None:
    """Set position and orientation of a foxglove.Pose from a rigid transform (4, 4)."""
    pose.position.x, pose.position.y, pose.position.z = X[:3, 3].tolist()
    x, y, z, w = Rotation.from_matrix(X[:3, :3]).as_quat().tolist()
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = x, y, z, w


def transforms(frames: Iterable[PosedFrame], time_ns: int) -> bytes:
    """foxglove.FrameTransforms of ``frames`` at ``time_ns``."""
    every = list(frames)
    quaternions = Rotation.from_matrix(np.array([frame.X[:3, :3] for frame in every])).as_quat().tolist()
    named = zip(every, quaternions, strict=True)
    return posed(
        [(frame.parent, frame.child, frame.X[:3, 3].tolist(), (w, x, y, z)) for frame, (x, y, z, w) in named],
        time_ns,
    )


def posed(frames: Iterable[tuple[str, str, Sequence[float], Sequence[float]]], time_ns: int) -> bytes:
    """foxglove.FrameTransforms at ``time_ns`` of frames, each parent, child, position (3,) and quaternion
    w, x, y, z.
    """
    said = FrameTransforms()
    for parent, child, p, q_wxyz in frames:
        made = said.transforms.add(parent_frame_id=parent, child_frame_id=child)
        put_time(made.timestamp, time_ns)
        made.translation.x, made.translation.y, made.translation.z = p
        made.rotation.w, made.rotation.x, made.rotation.y, made.rotation.z = q_wxyz
    return bytes(said.SerializeToString())


def log_line(time_ns: int, level: str, name: str, message: str) -> bytes:
    """foxglove.Log: ``level`` is info, warning or error, ``name`` who says it."""
    said = Log(level=LEVELS[level], message=message, name=name)
    put_time(said.timestamp, time_ns)
    return bytes(said.SerializeToString())
