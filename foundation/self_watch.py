"""A service's watch on itself: memory, and room on the disk."""

import asyncio
import os
import shutil
from pathlib import Path

from foundation.event_log import EventLog

_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


def resident_mb(pid: int | None = None) -> float:
    """Resident memory of a process (None: this one) in MB; 0 when it has gone."""
    try:
        text = Path(f"/proc/{pid or 'self'}/statm").read_text(encoding="ascii")
    except OSError:
        return 0.0
    return int(text.split()[1]) * _PAGE_MB


DISK_LOW_MB, DISK_FULL_MB = 200.0, 20.0
_LOOK_S = 1.0


class DiskWatch:
    """Looks whether the disk has room for records in ``directory``, and leaves that in the log's ``room``."""

    def __init__(self, log: EventLog, directory: Path | None) -> None:
        self._log = log
        self._directory = directory
        self._level = 0

    async def keep_looking(self) -> None:
        """Look once a second until cancelled; without a directory there is nothing to do."""
        while self._directory is not None:
            self.look(self._directory)
            await asyncio.sleep(_LOOK_S)

    def look(self, directory: Path) -> None:
        """Look now, and tell of a level that was crossed."""
        try:
            free_mb = shutil.disk_usage(directory).free / 1e6
        except OSError:
            free_mb = 0.0  # the directory has gone
        self._log.room = free_mb >= DISK_FULL_MB
        level = sum(free_mb < limit for limit in (DISK_LOW_MB, DISK_FULL_MB))
        if level > self._level:
            detail = f"{directory}: {free_mb:.0f} MB left; below {DISK_FULL_MB:.0f} MB no motion is begun"
            self._log.write("disk_low", "warning", cause="recording.disk_low", detail=detail)
        self._level = level
