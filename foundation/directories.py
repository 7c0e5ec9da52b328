"""Directories that the command line names, tried before anything starts."""

from pathlib import Path

from protocol.errors import ConfigurationError


def recording_directory(directory: Path | None) -> Path | None:
    """``--record-dir`` as ``writable_directory``; None where nothing is to be recorded."""
    if directory is None:
        return None
    return writable_directory(directory, "configuration.record_dir_unwritable", f"--record-dir {directory}")


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
