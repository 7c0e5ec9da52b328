"""What a recording of the vision PC says of itself: its configuration, and what made it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Message, Metadata

from foundation.configuration import merged, validated
from foundation.recording.beginning import session_entries
from foundation.recording.decoding import Damage, RecordingUnreadable, messages, walk
from foundation.recording.messages import fields_of
from nominal_arm.description import NominalArm
from vision_pc.config.vision import VisionConfig
from vision_pc.core.types import Look, WatchSample
from vision_pc.shell.recording import read_messages as reads
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_recorder as topics


class RecordedVision(NamedTuple):
    """What a recording says of itself. ``exact``: made by these very versions on this kind of machine.

    ``pictured``: its eyes had pictures.
    """

    path: Path
    config: VisionConfig
    arm: NominalArm
    session: Mapping[str, str]
    images: str
    exact: bool
    pictured: bool

    @property
    def run(self) -> Path:
        """The run's directory, where `longreach up` leaves it and the other processes' recordings."""
        return self.path.absolute().parent.parent


def recorded_vision(path: Path, overrides: Mapping[str, Any] | None = None) -> RecordedVision:
    """The recording at ``path``, its configuration with ``overrides`` laid over it.

    Raises OSError, RecordingUnreadable (``recording.not_vision``), ConfigurationError.
    """
    metadata = metadata_of(path)
    run = json.loads(metadata.get("run", {}).get("configuration", "{}"))
    if "vision" not in run:
        why = f"{path.name}: no recording of the vision PC, whose name is {topics.FILE}"
        raise RecordingUnreadable("recording.not_vision", why)
    config = validated(VisionConfig, merged(run["vision"], overrides or {}), path.name)
    arm = validated(NominalArm, run["arm"], path.name)
    session = metadata.get("session", {})
    here = session_entries("vision_pc", {})
    same = all(session.get(name) == value for name, value in here.items() if name not in ("id", "service"))
    pictured = session.get(topics.EYES) != topics.SIMULATED
    return RecordedVision(path, config, arm, session, run["vision"]["recording"]["images"], same, pictured)


def metadata_of(path: Path) -> dict[str, dict[str, str]]:
    """The metadata of the recording at ``path``, by name. Raises OSError, RecordingUnreadable."""
    found: dict[str, dict[str, str]] = {}
    with path.open("rb") as stream:
        for record in walk(stream):
            if isinstance(record, Metadata):
                found[record.name] = record.metadata
            elif isinstance(record, Message):
                break
    return found


_TOPICS = (topics.EVENT, topics.READ, topics.SAMPLE, topics.LOOK, topics.REFERENCE)
_BEGINS = {"operation_queued": "request", "operation": "body"}  # behind the API, in lockstep
_ENDS = ("operation_ended", "operation_failed")


class BegunOperation(NamedTuple):
    """An operation as it was asked for."""

    kind: str
    body: dict[str, Any]
    log_ns: int


class Ending(NamedTuple):
    """How an operation ended: ``state`` succeeded, failed or cancelled, its result, or the cause."""

    state: str
    result: Any
    cause: str | None


class SentReference(NamedTuple):
    """A longreach.Reference and when it was sent."""

    log_ns: int
    message: Any


class AnsweredCall(NamedTuple):
    """A longreach.Read, and the references that were sent since the one before it."""

    message: Any
    log_ns: int
    references: tuple[SentReference, ...]


class RecordedOperations:
    """Goes through the recording at ``path`` once. ``looks`` and ``samples``, by watch, are those so far.

    ``ending``: of the operation that was gone through, None before its end, or where the file ends before.
    ``unread``: references that no answer came after. ``damages``: what of the file could not be read.
    """

    def __init__(self, path: Path) -> None:
        self.looks: list[Look] = []
        self.samples: dict[int, list[WatchSample]] = {}
        self.ending: Ending | None = None
        self.damages: list[Damage] = []
        self.unread: list[SentReference] = []
        self._messages = messages(path, _TOPICS, self.damages)
        self._ahead: AnsweredCall | None = None
        self._in_operation = False

    def next_operation(self) -> BegunOperation | None:
        """The next operation; None at the end of the file. What is left of the one before is passed over."""
        while self._in_operation and self.next_call() is not None:
            pass
        for topic, record in self._messages:
            begun = (
                self._operation_begun(fields_of(record.data), record.log_time)
                if topic == topics.EVENT
                else None
            )
            if begun is not None:
                self._in_operation, self.ending = True, None
                self.unread.clear()
                return begun
            self._keep(topic, record)
        return None

    def next_call(self) -> AnsweredCall | None:
        """The next answer within the operation; None after its last."""
        found, self._ahead = self._ahead or self._next(), None
        return found

    def peek(self) -> AnsweredCall | None:
        """What ``next_call`` will return."""
        self._ahead = self._ahead or self._next()
        return self._ahead

    def _next(self) -> AnsweredCall | None:
        while self._in_operation:
            topic, record = next(self._messages, ("", None))
            if record is None:
                self._in_operation = False
            elif topic == topics.READ:
                sent, self.unread = tuple(self.unread), []
                return AnsweredCall(reads.ReadMessage.FromString(record.data), record.log_time, sent)
            elif topic == topics.REFERENCE:
                said = own.ReferenceMessage.FromString(record.data)
                self.unread.append(SentReference(record.log_time, said))
            elif topic == topics.EVENT:
                self.ending = _ending(fields_of(record.data))
                self._in_operation = self.ending is None
            else:
                self._keep(topic, record)
        return None

    def _keep(self, topic: str, record: Message) -> None:
        if topic == topics.LOOK:
            self.looks.append(reads.look_of_message(own.LookMessage.FromString(record.data)))
        elif topic == topics.SAMPLE:
            said = reads.SampleMessage.FromString(record.data)
            samples = self.samples.setdefault(said.watch, [])
            samples[said.number :] = [reads.sample_of_message(said)]

    def _operation_begun(self, said: dict[str, Any], log_ns: int) -> BegunOperation | None:
        if said["event"] not in _BEGINS:
            return None
        return BegunOperation(said["kind"], said.get(_BEGINS[said["event"]]) or {}, log_ns)


def _ending(said: dict[str, Any]) -> Ending | None:
    """How an operation ended, if that is what an event tells."""
    if said["event"] not in _ENDS:
        return None
    cause = said.get("cause") or (said.get("problem") or {}).get("cause")
    state = said.get("state") or ("failed" if said["event"] == "operation_failed" else "succeeded")
    return Ending(state, said.get("result"), cause)


def in_json(ending: Ending) -> bytes:
    """All of it as it is in a recording."""
    return json.dumps(ending._asdict()).encode()
