"""What trying out the valves leaves on disk: one file a joint, and how it ended."""

import asyncio
import json
from pathlib import Path
from typing import Any, NamedTuple

from controller.core.excitation.excitation_state import Phase
from controller.core.excitation.plan import ExcitationPlan, Stroke
from controller.core.excitation.program import ExcitationSample
from controller.core.scan_program import ScanProgram
from foundation.event_log import EventLog
from nominal_arm.commissioned import Basis
from nominal_arm.description import JOINT_NAMES
from protocol.errors import ConfigurationError

SUMMARY = "trials.json"


class TrialFile(NamedTuple):
    """One file to be written, and the summary as it is from then on."""

    path: Path
    samples: list[ExcitationSample]
    strokes: tuple[Stroke, ...]
    told: dict[str, Any]


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
        self._told: dict[str, Any] = {
            "basis": basis.model_dump(),
            "finished": [],
            "ended_by": None,
            "whole": False,
        }
        self._files: list[asyncio.Task[None]] = []
        if program.plan is not None and directory is not None:
            _summarise(directory, self._told)

    def follow(self) -> None:
        """See to what the latest scan left behind."""
        plan, trials = self._program.plan, self._program.excitation
        if plan is None or not self._program.samples:
            return
        if trials.stroke != self._stroke:
            name = JOINT_NAMES[plan.strokes[self._stroke].joint]
            finished = [*self._told["finished"], name]
            whole = trials.finished(plan)
            self._told = self._told | {"finished": finished, "ended_by": None, "whole": whole}
            self._keep(plan, f"trial_{name}.jsonl")
        elif trials.excitation is None or trials.excitation.phase is Phase.ENDED:
            name = JOINT_NAMES[plan.strokes[self._stroke].joint]
            trouble = trials.trouble
            broken = {"cause": "commissioning.stopped", "joint": name, "value": 0.0, "limit": 0.0}
            if trouble is not None:
                broken = trouble._asdict() | {"joint": JOINT_NAMES[trouble.joint]}
            self._told = self._told | {"ended_by": broken}
            self._keep(plan, f"trial_{name}_unfinished.jsonl")
        self._stroke = trials.stroke

    async def close(self) -> None:
        """Return once all files are written."""
        await asyncio.gather(*self._files)

    def _keep(self, plan: ExcitationPlan, name: str) -> None:
        assert self._directory is not None
        samples, self._program.samples = self._program.samples, []
        before = self._files[-1] if self._files else None
        recording = TrialFile(self._directory / name, samples, plan.strokes, self._told)
        self._files.append(asyncio.ensure_future(self._written(before, recording)))

    async def _written(self, before: asyncio.Task[None] | None, recording: TrialFile) -> None:
        if before is not None:
            await before  # in their order, so that the newest summary is written last
        try:
            await asyncio.to_thread(_write, recording)
        except OSError as error:
            why = f"{recording.path}: {error.strerror}"
            self._log.write("trial_record_failed", "error", cause="recording.unwritable", detail=why)
        else:
            self._log.write("trial_record", path=str(recording.path), scans=len(recording.samples))


def _write(recording: TrialFile) -> None:
    path, partial = recording.path, recording.path.with_suffix(".partial")
    with partial.open("w", encoding="utf-8") as file:
        header = {"basis": recording.told["basis"], "strokes": [list(each) for each in recording.strokes]}
        file.write(json.dumps(header) + "\n")
        for sample in recording.samples:  # one at a time, so that the scan gets the interpreter in between
            row = sample._replace(q=sample.q.tolist())
            file.write(json.dumps(list(row)) + "\n")
    partial.replace(path)
    _summarise(path.parent, recording.told)


def _summarise(directory: Path, told: dict[str, Any]) -> None:
    partial = directory / f"{SUMMARY}.partial"
    partial.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    partial.replace(directory / SUMMARY)
