"""Where a recording begins: the directory that the command line names, and the session that it is of."""

import importlib.metadata
import os
import platform
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path

from protocol.errors import ConfigurationError

SESSION_VARIABLE = "LONGREACH_SESSION"
_PACKAGES = ("longreach", "numpy", "scipy", "numba", "opencv-python-headless")
ROOM_WANTED_MB = 50.0  # some minutes of the plant's recording


def recording_directory(directory: Path | None) -> Path | None:
    """``--record-dir`` as ``writable_directory``; None where nothing is to be recorded.

    Raises ConfigurationError also where the disk has too little room left (``configuration.disk_full``).
    """
    if directory is None:
        return None
    what = f"--record-dir {directory}"
    writable_directory(directory, "configuration.record_dir_unwritable", what)
    free_mb = shutil.disk_usage(directory).free / 1e6
    if free_mb < ROOM_WANTED_MB:
        why = f"{what}: {free_mb:.0f} MB left on the disk, {ROOM_WANTED_MB:.0f} MB wanted to begin with"
        raise ConfigurationError("configuration.disk_full", why)
    return directory


def writable_directory(directory: Path, cause: str, what: str) -> Path:
    """``directory``, made where it is missing. Raises ConfigurationError when no file can be made in it.

    ``what`` names the setting in the error.
    """
    probe = directory / ".writable"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise ConfigurationError(cause, f"{what}: {error.strerror}") from error
    return directory


def session_entries(service: str, environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """The metadata ``session`` of a recording: its ``id``, from LONGREACH_SESSION or made anew, the
    ``service``, versions, and the kind of machine.
    """
    known = os.environ if environment is None else environment
    made = {"id": known.get(SESSION_VARIABLE) or str(uuid.uuid4()), "service": service}
    versions = {f"version {name}": _version(name) for name in _PACKAGES}
    return made | versions | {"version python": platform.python_version(), "machine": platform.machine()}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "absent"
