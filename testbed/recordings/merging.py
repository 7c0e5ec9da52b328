"""The recordings of one session on one clock, the vision PC's: how far off each part's may be is told."""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap.records import Attachment, Message

from foundation.recording.decoding import RecordingUnreadable, class_in, messages, walk
from foundation.recording.mcap_file import Topic
from foundation.recording.messages import PosedFrame, format_of, transforms
from foundation.recording.recovery import Contents, contents, new_recording
from plant_emulator.shell.scene_messages import CAMERA, WORLD
from plant_emulator.shell.truth_recorder import CAPTURE
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_recorder as vision
from vision_pc.shell.recording.vision_pictures import BASE_FRAME, CAMERA_FRAMES

PLANT, CONTROLLER, VISION = "plant_emulator", "controller", "vision_pc"
JOINTS = "/tf_joined"  # what ties the trees of frames of the three parts together
_STAMP = "google.protobuf.Timestamp"
_NS = 1_000_000_000


class ClockMap(NamedTuple):
    """A part's clock on the vision PC's: its time plus ``offset_ns``, and ``drift_ppm`` for what has passed
    since ``since_ns``. ``uncertainty_ns``: how far off that may be; ``samples`` it rests on.
    """

    since_ns: int
    offset_ns: int
    drift_ppm: float
    uncertainty_ns: int
    samples: int

    def on_vision(self, time_ns: int) -> int:
        """A time of the part's clock on the vision PC's."""
        return time_ns + self.offset_ns + round(1e-6 * self.drift_ppm * (time_ns - self.since_ns))


SAME = ClockMap(0, 0, 0.0, 0, 0)


class _Part(NamedTuple):
    path: Path
    service: str
    found: Contents


def merge(files: Sequence[Path], target: Path, attached: Sequence[Path] = ()) -> dict[str, ClockMap]:
    """Write all messages of ``files``, recordings of one session, to ``target``; return each part's clock.

    ``log_time`` and the time stamps of well-known messages are then the vision PC's. The files
    ``attached``, such as the arm as URDF, are attached under their names. Raises OSError,
    FileExistsError, RecordingUnreadable: ``recording.other_session``, ``recording.twice``,
    ``recording.no_clock``, ``recording.not_vision``, ``recording.no_session``.
    """
    parts = _parts(files)
    clocks = {part.service: _clock(part, parts) for part in parts.values()}
    topics: list[Topic] = []
    numbers: dict[tuple[str, int], int] = {}
    for part in parts.values():
        for channel, topic in part.found.topics.items():
            numbers[part.service, channel] = len(topics)
            topics.append(topic)
    topics.append(Topic(JOINTS, format_of(FrameTransforms), bytes))
    with new_recording(target, topics, _metadata(parts, clocks), _attachments(attached)) as file:
        streams = [_on_common_clock(part, clocks[part.service], numbers) for part in parts.values()]
        joined = False
        for log_ns, number, data, publish_ns in heapq.merge(*streams, key=lambda each: each[0]):
            if not joined:
                file.add(len(topics) - 1, _joints(log_ns), log_ns, log_ns)
                joined = True
            file.add(number, data, log_ns, publish_ns)
    return clocks


def _parts(files: Sequence[Path]) -> dict[str, _Part]:
    parts: dict[str, _Part] = {}
    for path in files:
        found = contents(path)
        service = found.metadata.get("session", {}).get("service", "")
        if service not in (PLANT, CONTROLLER, VISION):
            raise RecordingUnreadable("recording.no_session", f"{path}: does not say which service wrote it")
        if service in parts:
            why = f"{path}: of {service}, as {parts[service].path}"
            raise RecordingUnreadable("recording.twice", why)
        parts[service] = _Part(path, service, found)
    sessions = {part.found.metadata["session"]["id"]: part.path for part in parts.values()}
    if len(sessions) > 1:
        told = "; ".join(f"{path}: {session}" for session, path in sessions.items())
        raise RecordingUnreadable("recording.other_session", f"not of one session: {told}")
    if VISION not in parts:
        why = f"{', '.join(map(str, files))}: none of the vision PC, whose clock is the common one"
        raise RecordingUnreadable("recording.not_vision", why)
    return parts


def _clock(part: _Part, parts: Mapping[str, _Part]) -> ClockMap:
    """The part's clock: the controller's by what the link knew of it, the plant's by frames both saw."""
    if part.service == VISION:
        return SAME
    seen = parts[VISION]
    if part.service == CONTROLLER:
        told = [(log_ns, own.ClockMessage.FromString(data)) for log_ns, data in _of(seen, vision.CLOCK)]
        samples = [(log_ns + said.offset_ns, -said.offset_ns, said.uncertainty_ns) for log_ns, said in told]
    else:
        frames = [own.FrameMessage.FromString(data) for _, data in _of(seen, vision.FRAME)]
        captures = {said.frame_id: said.capture_ns for said in frames}
        taken = _capture_times(part)
        both = sorted(captures.keys() & taken.keys())
        samples = [(taken[number], captures[number] - taken[number], 0) for number in both]
    if not samples:
        why = f"{part.path}: nothing in {seen.path} tells how its clock stands to the vision PC's"
        raise RecordingUnreadable("recording.no_clock", why)
    return fitted_clock(samples)


def fitted_clock(samples: Sequence[tuple[int, int, int]]) -> ClockMap:
    """The clock through ``samples``: a part's time, vision's minus it, and how far off that may be (ns).

    A straight line over more than ten seconds, else the median. Its uncertainty is the largest that any
    sample allows: its own and how far the line passes beside it.
    """
    since_ns, middle_ns = samples[0][0], int(np.median([offset for _, offset, _ in samples]))
    seconds = np.array([1e-9 * (time_ns - since_ns) for time_ns, _, _ in samples])
    rest = np.array([offset - middle_ns for _, offset, _ in samples], dtype=np.float64)
    bounds = np.array([bound for _, _, bound in samples], dtype=np.float64)
    slope, begun = 0.0, 0.0
    if len(samples) > 2 and seconds[-1] > 10.0:
        slope, begun = np.polyfit(seconds, rest, 1, w=1.0 / np.maximum(bounds, 1.0))
    beside = np.abs(rest - begun - slope * seconds)
    uncertainty_ns = int(np.ceil((beside + bounds).max()))
    return ClockMap(since_ns, middle_ns + round(begun), 1e-3 * float(slope), uncertainty_ns, len(samples))


def _of(part: _Part, topic: str) -> Iterator[tuple[int, bytes]]:
    """Log times and data of a part's messages on ``topic``."""
    return ((record.log_time, record.data) for _, record in messages(part.path, {topic}))


def _capture_times(part: _Part) -> dict[int, int]:
    form = next((topic.format for topic in part.found.topics.values() if topic.name == CAPTURE), None)
    if form is None:
        return {}
    made = class_in(form)
    return {made.FromString(data).frame_id: log_ns for log_ns, data in _of(part, CAPTURE)}


def _on_common_clock(
    part: _Part, clock: ClockMap, numbers: Mapping[tuple[str, int], int]
) -> Iterator[tuple[int, int, bytes, int]]:
    """Log time on the common clock, topic number, data and publish time of each message."""
    stamped = {
        channel: class_in(topic.format)
        for channel, topic in part.found.topics.items()
        if topic.format.schema.startswith("foxglove.") and part.service != VISION
    }
    with part.path.open("rb") as stream:
        for record in walk(stream):
            if isinstance(record, Message) and (part.service, record.channel_id) in numbers:
                data = record.data
                if record.channel_id in stamped:
                    said = stamped[record.channel_id].FromString(data)
                    _move_stamps(said, clock)
                    data = said.SerializeToString()
                number = numbers[part.service, record.channel_id]
                yield clock.on_vision(record.log_time), number, data, record.publish_time


def _move_stamps(message: Any, clock: ClockMap) -> None:
    """Set every Timestamp in ``message`` to the common clock."""
    for field, value in message.ListFields():
        if field.message_type is None:
            continue
        for each in value if field.is_repeated else [value]:
            if field.message_type.full_name == _STAMP:
                moved_ns = clock.on_vision(each.seconds * _NS + each.nanos)
                each.seconds, each.nanos = divmod(moved_ns, _NS)
            else:
                _move_stamps(each, clock)


def _joints(log_ns: int) -> bytes:
    """The controller's base stands in the world, vision's left eye is the true one: one tree for viewers."""
    frames = [PosedFrame(WORLD, BASE_FRAME, np.eye(4)), PosedFrame(CAMERA, CAMERA_FRAMES[0], np.eye(4))]
    return transforms(frames, log_ns)


def _metadata(parts: Mapping[str, _Part], clocks: Mapping[str, ClockMap]) -> dict[str, dict[str, str]]:
    session = next(iter(parts.values())).found.metadata["session"]["id"]
    entries = {"session": {"id": session, "service": "merged", "clock": VISION}}
    for name, part in parts.items():
        entries[f"{name} session"] = part.found.metadata["session"]
        entries[f"{name} run"] = part.found.metadata.get("run", {})
        entries[f"{name} clock"] = {key: str(value) for key, value in clocks[name]._asdict().items()}
    return entries


def _attachments(files: Sequence[Path]) -> list[Attachment]:
    kinds = {".urdf": "application/xml", ".json": "application/json"}
    return [
        Attachment(0, 0, path.name, kinds.get(path.suffix, "application/octet-stream"), path.read_bytes())
        for path in files
    ]
