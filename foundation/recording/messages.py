"""What is recorded as Protobuf: well-known schemas that viewers draw, and flat messages made from a table."""

import json
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from foundation import clock
from foundation.periods import take_fifo
from foundation.recording.mcap_file import CHUNK_NS, Entries, Format, McapFile, Topic

_Item = tuple[int, Any, int, int]
# [D] At 60 messages a second a disk may hang for half a minute before one is lost.
WAITING_MAX = 2000
_CLOSE_S = 10.0
_BELOW_ALL = 1  # of FIFO priorities
_SWITCH_S = 0.0001  # how long the thread keeps the loop from the interpreter; Python's own are 5 ms


class RecordSink(Protocol):
    """Where messages of known topics go: to a thread, or into the file at once."""

    path: Path
    failure: str

    @property
    def dropped(self) -> int:
        """How many messages made room for newer ones."""
        ...

    @property
    def written(self) -> int:
        """How many messages were taken into the file."""
        ...

    def wants(self, topic: int) -> bool:
        """Whether a message of topic number ``topic`` is of use to anybody."""
        ...

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        """Record ``message`` on topic number ``topic``; never drop what is ``wanted``."""
        ...

    def close(self) -> None:
        """Write what waits and the summary, and close the file."""
        ...


class DirectRecording:
    """Records at once, for simulated time: the same file from the same run. Raises OSError of a full disk."""

    failure = ""
    dropped = 0

    def __init__(self, path: Path, topics: Sequence[Topic], metadata: Entries) -> None:
        """Create ``path``. Raises FileExistsError where it exists, OSError when it cannot be written."""
        self.path = path
        self._file = McapFile(path, topics, metadata)

    @property
    def written(self) -> int:
        """How many messages were taken into the file."""
        return self._file.messages

    def wants(self, topic: int) -> bool:
        """Always."""
        return True

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        """Record ``message`` on topic number ``topic``."""
        self._file.add(topic, message, log_ns, publish_ns)

    def close(self) -> None:
        """Write the summary and close the file."""
        self._file.close()


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


def event_bytes(content: Mapping[str, Any]) -> bytes:
    """longreach.Event of ``event`` and whatever else ``content`` holds."""
    rest = {name: value for name, value in content.items() if name != "event"}
    text = json.dumps(rest, separators=(",", ":"), default=str)
    return bytes(EventMessage(event=content["event"], fields_json=text).SerializeToString())


def fields_of(data: bytes) -> dict[str, Any]:
    """What ``event_bytes`` was given."""
    content = EventMessage.FromString(data)
    fields: dict[str, Any] = json.loads(content.fields_json)
    return {"event": content.event} | fields


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
    content = FrameTransforms()
    for parent, child, p, q_wxyz in frames:
        made = content.transforms.add(parent_frame_id=parent, child_frame_id=child)
        put_time(made.timestamp, time_ns)
        made.translation.x, made.translation.y, made.translation.z = p
        made.rotation.w, made.rotation.x, made.rotation.y, made.rotation.z = q_wxyz
    return bytes(content.SerializeToString())


def log_line(time_ns: int, level: str, name: str, message: str) -> bytes:
    """foxglove.Log: ``level`` is info, warning or error, ``name`` who says it."""
    content = Log(level=LEVELS[level], message=message, name=name)
    put_time(content.timestamp, time_ns)
    return bytes(content.SerializeToString())


WallMessage = message_class("Wall", (MessageField("unix_ns", "int64"),))
_WALL = Topic(
    "/wall", format_of(WallMessage), lambda unix_ns: WallMessage(unix_ns=unix_ns).SerializeToString()
)
_WALL_NS, _NEVER_NS = 1_000_000_000, 1 << 63


class RecordingThread:
    """Records in a thread of its own; ``put`` takes some microseconds and waits for nothing.

    What is put must not change afterwards. ``dropped``: messages that found ``WAITING_MAX`` others waiting;
    those put with ``wanted`` are never dropped. ``failure``: why nothing more can be written, such as a full
    disk; empty while all is well. What was put reaches the operating system within half a second. By the
    plant's clock the wall's time stands beside that of the messages once a second, on ``/wall``.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[Topic],
        metadata: Entries,
        fifo_priority: int = 0,
        tap: Callable[[int, bytes, int], None] | None = None,
    ) -> None:
        """Create ``path``. ``fifo_priority``: of the loop, 0 where it asks for none. ``tap`` is called with
        topic, encoded message and its time once it is taken into the file, in the recording's thread.

        The thread takes the lowest where the loop has one: while it has the interpreter, which the loop waits
        for, no ordinary process may put it aside. Raises FileExistsError where it exists, OSError when it
        cannot be written.
        """
        self.path = path
        self.dropped = 0
        self.failure = ""
        self._file = McapFile(path, topics if clock.is_wall() else (*topics, _WALL), metadata)
        self._wall, self._wall_due_ns = len(topics), _NEVER_NS if clock.is_wall() else 0
        self._tap = tap
        self._fifo_priority = min(fifo_priority, _BELOW_ALL)
        self._items: queue.SimpleQueue[_Item | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write_items, name=f"record-{path.name}", daemon=True)
        sys.setswitchinterval(_SWITCH_S)
        self._thread.start()

    @property
    def written(self) -> int:
        """How many messages were taken into the file."""
        return self._file.messages

    def wants(self, topic: int) -> bool:
        """Always."""
        return True

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        """Record ``message`` on topic number ``topic``."""
        if self.failure:
            return
        if not wanted and self._items.qsize() >= WAITING_MAX:
            self.dropped += 1
            return
        self._items.put((topic, message, log_ns, publish_ns))

    def close(self) -> None:
        """Write what waits and the summary, and close the file. What can no longer be written is left out."""
        self._items.put(None)
        self._thread.join(_CLOSE_S)

    def _write_items(self) -> None:
        take_fifo(self._fifo_priority)
        try:
            self._keep_writing()
            self._file.close()
        except Exception as error:  # also what cannot be encoded ends the recording, never the service
            self.failure = getattr(error, "strerror", None) or repr(error)
            self._file.abandon()

    def _keep_writing(self) -> None:
        """Write until asked to end: a chunk is closed by the time of its messages, or when no more come."""
        period_s = 1e-9 * CHUNK_NS
        due_s = time.monotonic() + period_s
        while True:
            try:
                item = self._items.get(timeout=max(due_s - time.monotonic(), 0.0))
            except queue.Empty:
                self._file.flush()
                due_s = time.monotonic() + period_s
                continue
            if item is None:
                return
            data = self._file.add(*item)
            if item[2] >= self._wall_due_ns:
                self._wall_due_ns = item[2] + _WALL_NS
                self._file.add(self._wall, time.time_ns(), item[2], item[2])
            if self._tap is not None:
                self._tap(item[0], data, item[2])
