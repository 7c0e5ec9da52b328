"""Writes the flight recorder out after a fault, beside the scan and not within it."""

import asyncio
import json
from collections.abc import Sequence
from pathlib import Path

from controller.core.flight_recorder import Scan, plain
from foundation.event_log import EventLog


async def dump(directory: Path, fault: str, number: int, scans: Sequence[Scan], log: EventLog) -> None:
    """Write ``scans`` as JSON lines, oldest first, to ``flight_<number>_<fault>.jsonl``; a full disk is
    logged."""
    path = directory / f"flight_{number:03d}_{fault.lower()}.jsonl"
    try:
        await asyncio.to_thread(_write, path, scans)
    except OSError as error:
        log.write(
            "flight_record_failed", "error", cause="recording.unwritable", detail=f"{path}: {error.strerror}"
        )
    else:
        log.write("flight_record", path=str(path), scans=len(scans), fault=fault)


def _write(path: Path, scans: Sequence[Scan]) -> None:
    with path.open("w", encoding="utf-8") as file:
        for each in scans:  # one at a time: the scan gets the interpreter in between, and memory stays small
            file.write(json.dumps(plain(each)) + "\n")
