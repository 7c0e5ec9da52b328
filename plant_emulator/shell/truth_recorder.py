"""The plant's recorder: its topics, what they hold, and what is never dropped."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from numpy.typing import NDArray

from foundation.recording.mcap_file import Topic
from foundation.recording.messages import (
    EventMessage,
    MessageField,
    RecordingThread,
    event_bytes,
    format_of,
    log_line,
    message_class,
    transforms,
)
from foundation.recording.recorder import OpenSink, ServiceRecorder
from plant_emulator.core.camera.exposures import CameraMotion
from plant_emulator.core.faults.schedule import FaultChange
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.scene_messages import SceneDrawing, frames
from plant_emulator.shell.truth_message import TruthMessage, truth_bytes

TRUTH, CAPTURE, FAULT, EVENT = "/plant/truth", "/plant/capture", "/plant/fault", "/plant/event"
FRAMES, SCENE, CAMERA, LOG = "/tf_true", "/scene", "/camera_true/left/calibration", "/plant/log"

FaultMessage = message_class(
    "Fault",
    (
        MessageField("phase", "string"),
        MessageField("time_ns", "int64"),
        MessageField("number", "int64"),
        MessageField("name", "string"),
        MessageField("start_ns", "int64"),
        MessageField("end_ns", "int64"),
        MessageField("fault_json", "string"),
    ),
)


class TruthRecord(NamedTuple):
    """One recorded instant. ``frame_id`` is None between captures.

    ``holes_O`` (n, 3): middles of the wall's drill holes; what is read has none.
    ``motion``: how camera and tool marker moved, at captures of a camera that shows it.
    """

    log_ns: int
    frame_id: int | None
    truth: PlantTruth
    holes_O: NDArray[np.float64] | None = None
    motion: CameraMotion | None = None


class _Posed(NamedTuple):
    log_ns: int
    truth: PlantTruth
    links: tuple[str, ...]
    X_WL: NDArray[np.float64]


def _fault_bytes(entry: Mapping[str, Any]) -> bytes:
    plain = {name: value for name, value in entry.items() if name != "fault" and value is not None}
    return bytes(FaultMessage(**plain, fault_json=_json(entry["fault"])).SerializeToString())


def _frames_bytes(posed: _Posed) -> bytes:
    return transforms(frames(posed.truth, posed.links, posed.X_WL), posed.log_ns)


def _log_bytes(line: tuple[int, str, str]) -> bytes:
    return log_line(line[0], line[1], "plant_emulator", line[2])


def _json(entry: Any) -> str:
    return json.dumps(entry, separators=(",", ":"))


def _capture_bytes(record: TruthRecord) -> bytes:
    return truth_bytes(record.truth, record.frame_id, record.holes_O, record.motion)


TOPICS = (
    Topic(TRUTH, format_of(TruthMessage), lambda record: truth_bytes(record.truth, None)),
    Topic(CAPTURE, format_of(TruthMessage), _capture_bytes),
    Topic(FAULT, format_of(FaultMessage), _fault_bytes),
    Topic(EVENT, format_of(EventMessage), event_bytes),
    Topic(FRAMES, format_of(FrameTransforms), _frames_bytes),
    Topic(SCENE, format_of(SceneUpdate), bytes, once=True),
    Topic(CAMERA, format_of(CameraCalibration), bytes, once=True),
    Topic(LOG, format_of(Log), _log_bytes),
)


class TruthRecorder(ServiceRecorder):
    """Records the truth. Nothing is encoded or written before a call returns, see ``RecordingThread``.

    Everything is on its way to the disk within half a second. Faults, events and the drawing are never
    dropped.
    """

    def __init__(
        self,
        path: Path,
        run: Mapping[str, Any],
        drawn: SceneDrawing | None = None,
        session: Mapping[str, str] | None = None,
        made: OpenSink = RecordingThread,
    ) -> None:
        """Create ``path``; ``run`` and ``session`` go into the metadata. Raises ConfigurationError when it
        cannot be written.
        """
        super().__init__(path, TOPICS, run, session or {}, made)
        self._links = () if drawn is None else drawn.links
        self._holes_O = None if drawn is None else drawn.holes_O
        self._drawn = drawn

    def truth(self, truth: PlantTruth, log_ns: int, X_WL: NDArray[np.float64] | None = None) -> None:
        """Record the truth at ``log_ns``, and where the drawing's links then are: ``X_WL`` (n, 4, 4)."""
        self._put(TRUTH, TruthRecord(log_ns, None, truth), X_WL)

    def capture(
        self,
        truth: PlantTruth,
        log_ns: int,
        frame_id: int,
        X_WL: NDArray[np.float64] | None = None,
        motion: CameraMotion | None = None,
    ) -> None:
        """Record the truth at the instant at which frame ``frame_id`` is exposed.

        ``motion``: how camera and tool marker move then, where the picture depends on it.
        """
        self._put(CAPTURE, TruthRecord(log_ns, frame_id, truth, self._holes_O, motion), X_WL)

    def fault(self, change: FaultChange, log_ns: int) -> None:
        """Record that a fault was planned, began, ended or was withdrawn."""
        entry = change.as_dict()
        self.put(FAULT, entry, log_ns, change.time_ns, wanted=True)
        line = (log_ns, "warning", f"fault {entry['number']} {entry['phase']}: {entry['name']}")
        self.put(LOG, line, log_ns, change.time_ns, wanted=True)

    def event(self, fields: Mapping[str, Any], log_ns: int, time_ns: int) -> None:
        """Record that something happened: ``event`` and what belongs to it."""
        self.put(EVENT, dict(fields), log_ns, time_ns, wanted=True)
        line = (log_ns, "info", ", ".join(f"{name} {value}" for name, value in fields.items()))
        self.put(LOG, line, log_ns, time_ns, wanted=True)

    def _put(self, topic: str, record: TruthRecord, X_WL: NDArray[np.float64] | None) -> None:
        log_ns, time_ns = record.log_ns, record.truth.time_ns
        if self._drawn is not None:
            self.put(SCENE, self._drawn.scene, log_ns, time_ns, wanted=True)
            self.put(CAMERA, self._drawn.camera, log_ns, time_ns, wanted=True)
            self._drawn = None
        self.put(topic, record, log_ns, time_ns)
        if X_WL is not None:
            posed = _Posed(log_ns, record.truth, self._links, X_WL)
            self.put(FRAMES, posed, log_ns, time_ns)
