"""A commissioning session as a directory: one recording a finished joint, and what they rest on."""

import hashlib
import json
from pathlib import Path
from typing import Any

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from nominal_arm.description import JOINT_NAMES, NominalArm
from protocol.errors import ConfigurationError
from testbed.commissioning.recording import JointRecording, load_recording

_DIGITS = 16  # of a recording's hash, told with every number


class CommissioningSession:
    """What a session directory holds; every finished joint is kept at once.

    Raises ConfigurationError (``commissioning.other_session``) for a directory that was begun with another
    arm or configuration, ``commissioning.bad_session`` for one that cannot be read.
    """

    def __init__(self, directory: Path, arm: NominalArm, config: ControllerConfig) -> None:
        self.directory = directory
        basis = basis_of(arm, config).model_dump()
        self._state = _read(directory / "session.json") or {"basis": basis, "ended_by": None}
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


def _read(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigurationError("commissioning.bad_session", f"{path}: {error}") from error
    if not isinstance(found, dict):
        raise ConfigurationError("commissioning.bad_session", f"{path}: a mapping is wanted")
    return found
