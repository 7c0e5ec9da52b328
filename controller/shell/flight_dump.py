"""Writes the flight recorder out after a fault, beside the scan and not within it."""

import asyncio
import json
from pathlib import Path
from typing import Any

from foundation.event_log import EventLog


async def dump(
    directory: Path, fault: str, number: int, entries: list[dict[str, Any]], log: EventLog
) -> None:
    """Write ``entries`` as JSON lines, oldest first, to ``flight_<number>_<fault>.jsonl``; a full disk is
    logged."""
    path = directory / f"flight_{number:03d}_{fault.lower()}.jsonl"
    try:
        await asyncio.to_thread(_write, path, entries)
    except OSError as error:
        log.write(
            "flight_record_failed", "error", cause="recording.unwritable", detail=f"{path}: {error.strerror}"
        )
    else:
        log.write("flight_record", path=str(path), scans=len(entries), fault=fault)


def _write(path: Path, entries: list[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8") as file:
        for entry in entries:  # one at a time, so that the scan gets the interpreter in between
            file.write(json.dumps(entry) + "\n")
