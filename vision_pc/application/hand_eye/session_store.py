"""The guided sessions in one directory of the vision PC's disk."""

import json
import os
import re
from pathlib import Path

from protocol.errors import ConfigurationError, LongreachError, RequestRefused
from vision_pc.core.hand_eye.guided.session import Session, from_json, to_json
from vision_pc.core.types import CameraCalibration

_OWN = frozenset({".json", ".part"})
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


class SessionStore:
    """The sessions in one directory."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def refuse_strangers(self) -> None:
        """Raises ConfigurationError when the directory holds anything but sessions: it is somebody else's."""
        try:
            others = [path.name for path in self.directory.iterdir() if path.suffix not in _OWN]
        except FileNotFoundError:
            return  # it is made with the first session
        except OSError as error:
            why = f"sessions_dir = {self.directory}: {error.strerror}"
            raise ConfigurationError("configuration.sessions_dir_unreadable", why) from error
        if others:
            why = f"sessions_dir = {self.directory}: holds what is no session: {min(others)}"
            raise ConfigurationError("configuration.sessions_dir_not_ours", why)

    def names(self) -> list[str]:
        """All sessions, sorted."""
        return sorted(path.stem for path in self.directory.glob("*.json"))

    def path(self, name: str) -> Path:
        """A session's file. Raises RequestRefused (``refused.hand_eye.name``) for what is no plain name."""
        if not _NAME.fullmatch(name):
            raise RequestRefused(
                "refused.hand_eye.name",
                f"session name {name!r}: letters, digits, - and _ are wanted, 64 at most",
            )
        return self.directory / f"{name}.json"

    def save(self, session: Session) -> None:
        """Save the session on the disk. Raises LongreachError (``hand_eye.unwritable``)."""
        path = self.path(session.name)
        partial = path.with_suffix(".part")
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            with partial.open("w", encoding="utf-8") as file:
                json.dump(to_json(session), file, indent=1)
                file.write("\n")
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except OSError as error:
            raise LongreachError("hand_eye.unwritable", f"{path}: {error.strerror}") from error

    def load(self, name: str, camera: CameraCalibration) -> Session:
        """A session from the disk.

        Raises RequestRefused: ``refused.hand_eye.unknown_session``, or what is wrong with its file.
        """
        path = self.path(name)
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            known = ", ".join(self.names()) or "none"
            raise RequestRefused(
                "refused.hand_eye.unknown_session", f"no session '{name}'; there are: {known}"
            ) from None
        except OSError as error:
            raise RequestRefused("refused.hand_eye.format", f"{path}: {error.strerror}") from error
        except ValueError as error:
            raise RequestRefused("refused.hand_eye.format", f"{path.name}: not JSON: {error}") from error
        if not isinstance(document, dict):
            raise RequestRefused("refused.hand_eye.format", f"{path.name}: an object is wanted")
        return from_json(document, camera)
