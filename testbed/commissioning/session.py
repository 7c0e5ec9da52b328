"""A commissioning session as a directory: one recording a finished joint, and what they rest on."""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from foundation.configuration import StrictModel, validated
from nominal_arm.description import JOINT_NAMES, NominalArm
from plant_emulator.config.valves import JointName
from protocol.errors import ConfigurationError
from testbed.commissioning.recording import JointRecording, load_recording

_SEEN = "seen.json"
_DIGITS = 16  # of a recording's hash, told with every number


class ToldNumber(StrictModel):
    """A number and its standard deviation, in the unit that its name says."""

    value: float
    std: Annotated[float, Field(gt=0.0)]


class TrialsTold(StrictModel):
    """What ``valve-trials`` answers: half the plays, why others were not seen, the camera's delay."""

    play_mrad: dict[JointName, ToldNumber]
    unseen: dict[JointName, str] = Field(default_factory=dict)
    camera_delay_ms: ToldNumber | None = None


def trials_told(path: Path) -> TrialsTold:
    """What the vision PC told in ``path``: the operation as its API gives it, or its result alone.

    Raises ConfigurationError: ``commissioning.no_trials`` for one that failed, ``commissioning.bad_session``,
    ``configuration.…`` for anything else.
    """
    found = _read_json(path)
    if found is None:
        raise ConfigurationError("commissioning.bad_session", f"{path}: no such file")
    problem = found.get("problem") or found
    if isinstance(problem, dict) and "cause" in problem:
        why = f"{problem['cause']}: {problem.get('detail')}"
        raise ConfigurationError("commissioning.no_trials", f"{path}: the operation failed: {why}")
    return validated(TrialsTold, found.get("result") or found, str(path))


class CommissioningSession:
    """What a session directory holds; every finished joint is kept at once.

    Raises ConfigurationError (``commissioning.other_session``) for a directory that was begun with another
    arm or configuration, ``commissioning.bad_session`` for one that cannot be read.
    """

    def __init__(self, directory: Path, arm: NominalArm, config: ControllerConfig) -> None:
        self.directory = directory
        basis = basis_of(arm, config).model_dump()
        self._state = _read_json(directory / "session.json") or {"basis": basis, "ended_by": None}
        if self._state.get("basis") != basis:
            raise ConfigurationError(
                "commissioning.other_session",
                f"{directory}: begun with {self._state.get('basis')}, this machine is {basis}; take another "
                "directory",
            )

    @property
    def finished(self) -> dict[int, Path]:
        """The recording of every finished joint."""
        files = {joint: self._file(joint) for joint in range(len(JOINT_NAMES))}
        return {joint: path for joint, path in files.items() if path.is_file()}

    def recordings(self) -> dict[int, JointRecording]:
        """All recordings, read. Raises ConfigurationError for one that is none."""
        return {joint: load_recording(path) for joint, path in self.finished.items()}

    def source(self, joint: int) -> str:
        """How a number names the recording that it came from: file and hash."""
        path = self._file(joint)
        return f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:_DIGITS]}"

    def keep(self, recording: JointRecording) -> None:
        """Keep the recording of a finished joint."""
        self._write()
        recording.save(self._file(recording.joint))

    @property
    def seen(self) -> TrialsTold | None:
        """Plays and delay that the vision PC has told, None for none."""
        path = self.directory / _SEEN
        return trials_told(path) if path.is_file() else None

    def keep_seen(self, seen: TrialsTold) -> None:
        """Keep what the vision PC tells of joints, with what it told of others before."""
        before = self.seen
        if before is not None:
            seen = seen.model_copy(update={"play_mrad": before.play_mrad | seen.play_mrad})
        self._write()
        (self.directory / _SEEN).write_text(seen.model_dump_json(indent=2) + "\n", encoding="utf-8")

    def ended_by(self, cause: str | None) -> None:
        """Note what broke the latest run off, None for nothing."""
        self._state["ended_by"] = cause
        self._write()

    def _file(self, joint: int) -> Path:
        return self.directory / f"{JOINT_NAMES[joint]}.npz"

    def _write(self) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            text = json.dumps(self._state, indent=2) + "\n"
            (self.directory / "session.json").write_text(text, encoding="utf-8")
        except OSError as error:
            raise ConfigurationError("output.unwritable", f"{self.directory}: {error.strerror}") from error


def _read_json(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigurationError("commissioning.bad_session", f"{path}: {error}") from error
    if not isinstance(found, dict):
        raise ConfigurationError("commissioning.bad_session", f"{path}: a mapping is wanted")
    return found
