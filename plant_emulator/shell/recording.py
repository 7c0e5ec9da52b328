"""The plant's own recording of the truth: MCAP with JSON messages that survives a kill, and its reader.

docs/recording.md is the written format: channels, fields, units, frames.
"""

import json
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.exceptions import InvalidMagic, McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from foundation.recording.mcap_file import Format, Topic
from foundation.recording.recording_thread import RecordingThread
from plant_emulator.core.faults.schedule import FaultChange
from plant_emulator.core.truth import PlantTruth

TRUTH, CAPTURE, FAULT, EVENT = "/plant/truth", "/plant/capture", "/plant/fault", "/plant/event"
_SCHEMA = json.dumps(
    {
        "type": "object",
        "title": "longreach.PlantTruth",
        "description": "One instant of the plant. SI units and radians; poses are 4x4 rows; X_AB is B in A.",
        "properties": {
            name: {"type": "integer" if name == "time_ns" else ["number", "array"]}
            for name in PlantTruth._fields
        }
        | {"frame_id": {"type": "integer"}},
    }
).encode()


_FAULT_SCHEMA = json.dumps(
    {
        "type": "object",
        "title": "longreach.Fault",
        "description": "One step in the life of a fault. Times in nanoseconds of simulated time.",
        "properties": {
            "number": {"type": "integer"},
            "name": {"type": "string"},
            "phase": {"enum": ["planned", "began", "ended", "withdrawn"]},
            "time_ns": {"type": "integer"},
            "start_ns": {"type": "integer"},
            "end_ns": {"type": ["integer", "null"]},
            "fault": {"type": "object"},
        },
    }
).encode()
_EVENT_SCHEMA = b'{"type": "object", "title": "longreach.Event"}'


class TruthRecord(NamedTuple):
    """One recorded instant. ``frame_id`` is None between captures."""

    log_ns: int
    frame_id: int | None
    truth: PlantTruth


def _json(said: Mapping[str, Any]) -> bytes:
    return json.dumps(said, separators=(",", ":")).encode()


def _truth_json(record: TruthRecord) -> bytes:
    frame = {} if record.frame_id is None else {"frame_id": record.frame_id}
    values = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in record.truth._asdict().items()
    }
    return _json(frame | values)


def _format(name: str, schema: bytes) -> Format:
    return Format(name, "jsonschema", schema, "json")


_TOPICS = (
    Topic(TRUTH, _format("longreach.PlantTruth", _SCHEMA), _truth_json),
    Topic(CAPTURE, _format("longreach.PlantTruth", _SCHEMA), _truth_json),
    Topic(FAULT, _format("longreach.Fault", _FAULT_SCHEMA), _json),
    Topic(EVENT, _format("longreach.Event", _EVENT_SCHEMA), _json),
)
_NUMBERS = {topic.name: number for number, topic in enumerate(_TOPICS)}


class EventRecord(NamedTuple):
    """One recorded event."""

    log_ns: int
    time_ns: int
    fields: dict[str, Any]


class FaultRecord(NamedTuple):
    """One fault of a run: its kind and parameters, and from when to when it was in force.

    ``began_ns`` and ``ended_ns`` are simulated times, None where it did not; ``log_ns`` is the monotonic time
    at which it began, or at which it was first heard of.
    """

    number: int
    name: str
    fault: dict[str, Any]
    log_ns: int
    began_ns: int | None
    ended_ns: int | None


class Recording(NamedTuple):
    """What a recording holds, in order of writing. ``complete``: the file was closed, not cut off."""

    truths: tuple[TruthRecord, ...]
    faults: tuple[FaultRecord, ...]
    events: tuple[EventRecord, ...]
    run: dict[str, Any]
    complete: bool

    def stacked(self, field: str) -> NDArray[np.float64]:
        """One field of every truth as an array (n, …): ``p_CM`` gives (n, 3), ``X_BT`` (n, 4, 4)."""
        return np.array([getattr(record.truth, field) for record in self.truths], dtype=np.float64)

    def log_ns(self) -> NDArray[np.int64]:
        """Monotonic times (n,) of the truths."""
        return np.array([record.log_ns for record in self.truths], dtype=np.int64)


class TruthRecorder:
    """Writes a recording, in a thread of its own: see ``foundation.recording.recording_thread``.

    Everything is on its way to the disk within half a second. Faults and events are never dropped.
    """

    def __init__(self, path: Path, run: Mapping[str, Any]) -> None:
        """Create ``path``; ``run`` goes into the metadata. Raises OSError when it cannot be written."""
        self.path = path
        self._recorder = RecordingThread(path, _TOPICS, {"run": {"configuration": json.dumps(run)}})

    @property
    def failure(self) -> str:
        """Why nothing more can be written, such as a full disk; empty while all is well."""
        return self._recorder.failure

    @property
    def written(self) -> int:
        """How many messages were written."""
        return self._recorder.written

    @property
    def dropped(self) -> int:
        """How many truths were dropped because the disk did not keep up."""
        return self._recorder.dropped

    def truth(self, truth: PlantTruth, log_ns: int) -> None:
        """Record the truth at ``log_ns``."""
        self._recorder.put(_NUMBERS[TRUTH], TruthRecord(log_ns, None, truth), log_ns, truth.time_ns)

    def capture(self, truth: PlantTruth, log_ns: int, frame_id: int) -> None:
        """Record the truth at the instant at which frame ``frame_id`` is exposed."""
        self._recorder.put(_NUMBERS[CAPTURE], TruthRecord(log_ns, frame_id, truth), log_ns, truth.time_ns)

    def fault(self, change: FaultChange, log_ns: int) -> None:
        """Record that a fault was planned, began, ended or was withdrawn."""
        self._recorder.put(_NUMBERS[FAULT], change.as_dict(), log_ns, change.time_ns, wanted=True)

    def event(self, fields: Mapping[str, Any], log_ns: int, time_ns: int) -> None:
        """Record that something happened."""
        self._recorder.put(_NUMBERS[EVENT], dict(fields), log_ns, time_ns, wanted=True)

    def close(self) -> None:
        """Write what waits and the summary, and close the file. What can no longer be written is left out."""
        self._recorder.close()


def read_truth(path: Path) -> Recording:
    """The recording at ``path``, also one that a kill cut off: everything up to the cut.

    Raises OSError when the file cannot be read, InvalidMagic when it is not MCAP at all.
    """
    truths: list[TruthRecord] = []
    faults: dict[int, FaultRecord] = {}
    events: list[EventRecord] = []
    run: dict[str, Any] = {}
    topics: dict[int, str] = {}
    complete = False
    with path.open("rb") as stream:
        for record in _records(stream):
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Metadata) and record.name == "run":
                run = json.loads(record.metadata["configuration"])
            elif isinstance(record, Message):
                data = json.loads(record.data)
                if topics[record.channel_id] == FAULT:
                    faults[data["number"]] = _further(faults.get(data["number"]), data, record.log_time)
                elif topics[record.channel_id] == EVENT:
                    events.append(EventRecord(record.log_time, record.publish_time, data))
                else:
                    truths.append(TruthRecord(record.log_time, data.pop("frame_id", None), _truth(data)))
            elif record is None:
                complete = True
    return Recording(tuple(truths), tuple(faults.values()), tuple(events), run, complete)


def _records(stream: BinaryIO) -> Iterator[Any]:
    """Records up to the end or the cut; a final None tells that the end was reached in order."""
    try:
        yield from StreamReader(stream).records
    except InvalidMagic:
        raise
    except (McapError, struct.error):
        return  # a record that a kill cut off; all before it are whole
    yield None


def _further(known: FaultRecord | None, change: Mapping[str, Any], log_ns: int) -> FaultRecord:
    """What is known of a fault after one more change of it."""
    known = known or FaultRecord(change["number"], change["name"], change["fault"], log_ns, None, None)
    if change["phase"] == "began":
        return known._replace(log_ns=log_ns, began_ns=change["time_ns"])
    return known._replace(ended_ns=change["time_ns"]) if change["phase"] == "ended" else known


def _truth(data: Mapping[str, Any]) -> PlantTruth:
    values: dict[str, Any] = {
        name: np.array(value, dtype=np.float64) if isinstance(value, list) and name != "faults" else value
        for name, value in data.items()
    }
    values["faults"] = tuple(data["faults"])
    return PlantTruth(**values)
