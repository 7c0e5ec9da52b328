"""A service's watch on itself: overload, room on the disk, and statistics in a file."""

import asyncio
import json
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from foundation.event_log import EventLog
from foundation.periods import WINDOW_NS, Limit, OverloadWatch, Tally
from foundation.recording.beginning import writable_directory

_PERIOD_S = 10.0
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


class StatisticsFile:
    """A file of one JSON object, replaced as a whole: a reader sees the old one or the new one."""

    def __init__(
        self, path: Path | None, service: str, log: EventLog, gather: Callable[[], Mapping[str, Any]]
    ) -> None:
        """``path``: None writes nothing; ``gather`` returns what is written. Raises ConfigurationError
        when its directory is not writable.
        """
        self._path = path
        self._service = service
        self._log = log
        self._gather = gather
        self._replacing = threading.Lock()
        if path is not None:
            writable_directory(path.parent, "configuration.statistics_unwritable", f"--statistics {path}")

    async def keep_writing(self) -> None:
        """Write every ten seconds, until cancelled; in a thread: a disk may hang longer than a link."""
        while True:
            await asyncio.sleep(_PERIOD_S)
            if self._path is not None:
                await asyncio.to_thread(self._replace, self._path, self._text())

    def write(self) -> None:
        """Write the statistics of now, with the service's name before them. A failure is logged."""
        if self._path is not None:
            self._replace(self._path, self._text())

    def _text(self) -> str:
        shown = {"service": self._service, **self._gather(), "log_lines_dropped": self._log.dropped}
        return json.dumps(shown, indent=2) + "\n"

    def _replace(self, path: Path, text: str) -> None:
        partial = path.with_name(path.name + ".part")
        try:
            with self._replacing:
                partial.write_text(text, encoding="utf-8")
                partial.replace(path)
        except OSError as error:
            why = f"{path}: {error.strerror}"
            self._log.write("statistics_failed", "error", cause="statistics.unwritable", detail=why)


def resident_mb(pid: int | None = None) -> float:
    """Resident memory of a process (None: this one) in MB; 0 when it has gone."""
    try:
        text = Path(f"/proc/{pid or 'self'}/statm").read_text(encoding="ascii")
    except OSError:
        return 0.0
    return int(text.split()[1]) * _PAGE_MB


LOOP = "loop"
_TICK_S = 0.05
_LOOK_S = 1.0
_LOOP_LIMIT_PERCENT = 20.0
_STILL_S = 0.3  # a link is given up after 0.5 s of silence
_WORKED = 0.5  # share of a standstill; above it the service itself is what held its loop up
_TELL_AGAIN_NS = 30_000_000_000  # while it lasts
DISK_LOW_MB, DISK_FULL_MB = 200.0, 20.0


class SelfWatch:
    """Looks once a second, in the loop that serves; its own lateness there is one of the measures.

    ``overload``: one sentence while the machine is overloaded, else empty. Whether the disk has room for
    records is left in the log's ``room``.
    """

    def __init__(
        self,
        log: EventLog,
        limits: Mapping[str, Limit],
        counts: Callable[[], Mapping[str, Tally]],
        record_dir: Path | None,
    ) -> None:
        self._log = log
        loop = Limit(_LOOP_LIMIT_PERCENT, f"of the times at which {log.service} had to wake were missed")
        self._overload = OverloadWatch({LOOP: loop} | dict(limits))
        self._counts = counts
        self._record_dir = record_dir
        self._ticks = Tally(0, 0)
        self._still, self._still_until_ns = "", 0
        self._before = ""
        self._told_ns = 0
        self._disk_level = 0

    @property
    def overload(self) -> str:
        """One sentence with a figure while the machine is overloaded, else empty."""
        return self._overload.warning or self._still

    async def keep_looking(self) -> None:
        """Look until cancelled."""
        looked_s = time.monotonic()
        while True:
            began_s, worked_s = time.monotonic(), time.process_time()
            await asyncio.sleep(_TICK_S)
            now_s = time.monotonic()
            if now_s - began_s >= _STILL_S:
                self.stood_still(time.monotonic_ns(), now_s - began_s, time.process_time() - worked_s)
            missed = max(round((now_s - began_s) / _TICK_S) - 1, 0)
            self._ticks = Tally(self._ticks.done + 1, self._ticks.missed + missed)
            if now_s - looked_s >= _LOOK_S:
                looked_s = now_s
                self.look(time.monotonic_ns())

    def stood_still(self, now_ns: int, still_s: float, worked_s: float) -> None:
        """Tell that the loop did not run for ``still_s``, in which this process had ``worked_s`` of a core.

        Had it little, the machine is overloaded for the next seconds; else the service held itself up.
        """
        said = f"{self._log.service} stood still for {still_s:.2f} s"
        if worked_s > _WORKED * still_s:
            detail = f"{said}; it worked for {worked_s:.2f} s of it: its own work held it up"
            self._log.write("held_up", "warning", cause="service.held_up", detail=detail)
            return
        self._still = f"the machine is overloaded: {said} and had {worked_s:.2f} s of a processor in it"
        self._still_until_ns = now_ns + WINDOW_NS

    def look(self, now_ns: int) -> None:
        """Compare and tell what has changed."""
        before = self._before
        if now_ns >= self._still_until_ns:
            self._still = ""
        detail = self._overload.update(now_ns, {LOOP: self._ticks} | dict(self._counts())) or self._still
        self._before = detail
        if detail and (not before or now_ns - self._told_ns >= _TELL_AGAIN_NS):
            self._told_ns = now_ns
            self._log.write("overloaded", "warning", cause="machine.overloaded", detail=detail)
        elif before and not detail:
            self._log.write("overload_over", detail="the machine keeps up again")
        if self._record_dir is not None:
            self._look_at_disk(self._record_dir)

    def _look_at_disk(self, directory: Path) -> None:
        try:
            free_mb = shutil.disk_usage(directory).free / 1e6
        except OSError:
            free_mb = 0.0  # the directory has gone
        self._log.room = free_mb >= DISK_FULL_MB
        level = sum(free_mb < limit for limit in (DISK_LOW_MB, DISK_FULL_MB))
        if level > self._disk_level:
            detail = f"{directory}: {free_mb:.0f} MB left; below {DISK_FULL_MB:.0f} MB no motion is begun"
            self._log.write("disk_low", "warning", cause="recording.disk_low", detail=detail)
        self._disk_level = level
