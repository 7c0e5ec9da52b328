"""Figures about the process itself, for people and for soak tests."""

import json
import os
from pathlib import Path
from typing import Any

from controller.shell.event_log import EventLog

_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


def resident_mb() -> float:
    """Resident memory of this process in MB."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * _PAGE_MB


def write_figures(path: Path, figures: dict[str, Any], log: EventLog) -> None:
    """Write ``figures`` as JSON so that a reader sees the old file or the new one; a failure is logged."""
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        log.write(
            "statistics_failed", "error", cause="statistics.unwritable", detail=f"{path}: {error.strerror}"
        )
