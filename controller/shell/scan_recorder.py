"""What the controller saw and commanded, scan by scan, recorded beside the cycle."""

import asyncio
import json
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log

from controller.config import ControllerConfig
from controller.core.excitation.plan import ExcitationPlan, Phase, Stroke
from controller.core.excitation.program import ExcitationSample
from controller.core.scan_program import ScanProgram
from controller.core.scan_types import ControllerView, ScanEvent, ScanInput, ScanOutput
from foundation.event_log import EventLog, Level
from foundation.recording.beginning import session_entries
from foundation.recording.mcap_file import Topic
from foundation.recording.messages import (
    MessageField,
    RecordingThread,
    format_of,
    log_line,
    message_class,
    posed,
)
from foundation.recording.recorder import OpenSink, ServiceRecorder
from nominal_arm.commissioned import Basis
from nominal_arm.description import JOINT_NAMES, NominalArm
from protocol.errors import ConfigurationError
from protocol.pose import Pose
from protocol.process_image import SensorImage

SUMMARY = "trials.json"


class TrialFile(NamedTuple):
    """One file to be written, and the summary as it is from then on."""

    path: Path
    samples: list[ExcitationSample]
    strokes: tuple[Stroke, ...]
    summary: dict[str, Any]


class TrialRecords:
    """Writes ``trial_<joint>.jsonl`` once a joint is finished, ``…_unfinished.jsonl`` when it was broken off.

    ``trials.json`` is written at the start and after each: which joints are finished, whether these are all,
    what broke the latest off (None: nothing), and the basis on which their numbers rest. The first line of a
    recording holds basis and strokes, every other one the fields of an ExcitationSample. A file has its name
    only once it is whole.

    Raises ConfigurationError (``configuration.nothing_recorded``) where valves are tried out and there is no
    directory.
    """

    def __init__(self, directory: Path | None, program: ScanProgram, basis: Basis, log: EventLog) -> None:
        if program.plan is not None and directory is None:
            raise ConfigurationError(
                "configuration.nothing_recorded",
                "controller.excitation.enabled = true: what the valves do is recorded; name a directory by "
                "--record-dir",
            )
        self._directory = directory
        self._program = program
        self._log = log
        self._stroke = 0
        self._summary: dict[str, Any] = {
            "basis": basis.model_dump(),
            "finished": [],
            "ended_by": None,
            "whole": False,
        }
        self._files: list[asyncio.Task[None]] = []
        if program.plan is not None and directory is not None:
            summarise(directory, self._summary)

    def follow(self) -> None:
        """See to what the latest scan left behind."""
        plan, trials = self._program.plan, self._program.excitation
        if plan is None or not self._program.samples:
            return
        if trials.stroke != self._stroke:
            name = JOINT_NAMES[plan.strokes[self._stroke].joint]
            finished = [*self._summary["finished"], name]
            whole = trials.finished(plan)
            self._summary = self._summary | {"finished": finished, "ended_by": None, "whole": whole}
            self._keep(plan, f"trial_{name}.jsonl")
        elif trials.excitation is None or trials.excitation.phase is Phase.ENDED:
            name = JOINT_NAMES[plan.strokes[self._stroke].joint]
            failure = trials.failure
            broken = {"cause": "commissioning.stopped", "joint": name, "value": 0.0, "limit": 0.0}
            if failure is not None:
                broken = failure._asdict() | {"joint": JOINT_NAMES[failure.joint]}
            self._summary = self._summary | {"ended_by": broken}
            self._keep(plan, f"trial_{name}_unfinished.jsonl")
        self._stroke = trials.stroke

    async def close(self) -> None:
        """Return once all files are written."""
        await asyncio.gather(*self._files)

    def _keep(self, plan: ExcitationPlan, name: str) -> None:
        assert self._directory is not None
        samples, self._program.samples = self._program.samples, []
        before = self._files[-1] if self._files else None
        recording = TrialFile(self._directory / name, samples, plan.strokes, self._summary)
        self._files.append(asyncio.ensure_future(self._write_scans(before, recording)))

    async def _write_scans(self, before: asyncio.Task[None] | None, recording: TrialFile) -> None:
        if before is not None:
            await before  # in their order, so that the newest summary is written last
        try:
            await asyncio.to_thread(write_trial, recording)
        except OSError as error:
            why = f"{recording.path}: {error.strerror}"
            self._log.write("trial_record_failed", "error", cause="recording.unwritable", detail=why)
        else:
            self._log.write("trial_record", path=str(recording.path), scans=len(recording.samples))


def write_trial(recording: TrialFile) -> None:
    """Write the file and its summary. Raises OSError."""
    path, partial = recording.path, recording.path.with_suffix(".partial")
    with partial.open("w", encoding="utf-8") as file:
        header = {"basis": recording.summary["basis"], "strokes": [list(each) for each in recording.strokes]}
        file.write(json.dumps(header) + "\n")
        for sample in recording.samples:  # one at a time, so that the scan gets the interpreter in between
            row = sample._replace(q=sample.q.tolist())
            file.write(json.dumps(list(row)) + "\n")
    partial.replace(path)
    summarise(path.parent, recording.summary)


def summarise(directory: Path, summary: dict[str, Any]) -> None:
    """Write the summary of the trials in ``directory``. Raises OSError."""
    partial = directory / f"{SUMMARY}.partial"
    partial.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    partial.replace(directory / SUMMARY)


FILE = "controller.mcap"
STATE, FRAMES, LOG = "/controller/state", "/tf", "/controller/log"
WORLD, TOOL, COMMANDED = "world", "nominal/tool", "nominal/tool_commanded"

_SIXES = {"q_meas": "q_meas_{}_rad", "q_cmd": "q_cmd_{}_rad", "valves": "valve_{}"}
_POSES = ("X_BT", "X_BT_cmd")
_COUNTS = (
    "cycle", "group_state", "fault", "severity", "flags", "motion_id", "segment", "plant_exchange_failures",
    "stream_number",
)  # fmt: skip
_POSE = ("p_x_m", "p_y_m", "p_z_m", "q_w", "q_x", "q_y", "q_z")
_PRESSURES = tuple(f"pressure_{joint}_{side}_bar" for joint in JOINT_NAMES for side in "ab")
_READ = ("return_bar", "oil_temperature_degc")


def _fields() -> Iterator[MessageField]:
    yield from (MessageField(name, "int64") for name in _COUNTS)
    yield MessageField("motion_done", "bool")
    yield MessageField("reference_link_alive", "bool")
    yield MessageField("dt_s")
    yield MessageField("supply_bar")
    for pattern in _SIXES.values():
        yield from (MessageField(pattern.format(joint)) for joint in JOINT_NAMES)
    for name in _POSES:
        yield from (MessageField(f"{name}_{part}") for part in _POSE)
    yield from map(MessageField, (*_PRESSURES, *_READ))


StateMessage = message_class("ControllerState", list(_fields()))


def state_bytes(inputs: ScanInput, view: ControllerView) -> bytes:
    """longreach.ControllerState of a scan; pressures and oil are absent where the exchange failed."""
    values: dict[str, Any] = {name: int(getattr(view, name)) for name in _COUNTS}
    values |= {"motion_done": view.motion_done, "reference_link_alive": inputs.reference_link_alive}
    values |= {"dt_s": inputs.dt_s, "supply_bar": view.supply_bar}
    for name, pattern in _SIXES.items():
        values |= zip(map(pattern.format, JOINT_NAMES), getattr(view, name), strict=True)
    for name in _POSES:
        pose: Pose = getattr(view, name)
        values |= zip((f"{name}_{part}" for part in _POSE), (*pose.p_m, *pose.q_wxyz), strict=True)
    sensors = inputs.sensors
    if isinstance(sensors, SensorImage):
        values |= zip(_PRESSURES, (bar for pair in sensors.pressures_bar for bar in pair), strict=True)
        values |= {name: getattr(sensors, name) for name in _READ}
    return bytes(StateMessage(**values).SerializeToString())


def _frames_bytes(view: ControllerView) -> bytes:
    frames = ((TOOL, view.X_BT), (COMMANDED, view.X_BT_cmd))
    known = [(WORLD, child, pose.p_m, pose.q_wxyz) for child, pose in frames if pose.is_finite()]
    return posed(known, view.time_ns)


def _log_bytes(entry: tuple[int, Level, ScanEvent]) -> bytes:
    now_ns, level, event = entry
    return log_line(
        now_ns, level, "controller", f"{event.name}: {event.cause} {event.value:g} ({event.limit:g})"
    )


TOPICS = (
    Topic(STATE, format_of(StateMessage), lambda scan: state_bytes(*scan)),
    Topic(FRAMES, format_of(FrameTransforms), _frames_bytes),
    Topic(LOG, format_of(Log), _log_bytes),
)


class ScanRecorder(ServiceRecorder):
    """Records every ``every``-th scan, and all events. A call keeps references and waits for nothing."""

    def __init__(
        self,
        directory: Path,
        arm: NominalArm,
        config: ControllerConfig,
        *,
        session: Mapping[str, str] | None = None,
        made: OpenSink | None = None,
    ) -> None:
        """Create controller.mcap in ``directory``; ``made`` opens it, by default a thread below the cycle's.

        Raises ConfigurationError when it cannot be written.
        """
        run = {"arm": arm.model_dump(mode="json"), "controller": config.model_dump(mode="json")}
        entries = session_entries("controller") if session is None else session
        opened = made or partial(RecordingThread, fifo_priority=config.fifo_priority)
        super().__init__(directory / FILE, TOPICS, run, entries, opened)
        self.every = max(round(1e3 / (config.recording_hz * config.cycle_ms)), 1)

    def scan(self, inputs: ScanInput, output: ScanOutput) -> None:
        """Record a scan."""
        view, now_ns = output.view, inputs.now_ns
        if view.cycle % self.every == 0:
            self.put(STATE, (inputs, view), now_ns, now_ns)
            self.put(FRAMES, view, now_ns, now_ns)
        for event in output.events:
            level: Level = "error" if event.name == "fault" else "info"
            self.put(LOG, (now_ns, level, event), now_ns, now_ns, wanted=True)
