"""A service's watch on itself: whether its machine keeps up, and whether its records still have a disk."""

import asyncio
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from foundation.event_log import EventLog
from foundation.overload import Limit, OverloadWatch, Tally

LOOP = "loop"
_TICK_S = 0.05
_LOOK_S = 1.0
_LOOP_LIMIT_PERCENT = 20.0
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
        self._told_ns = 0
        self._disk_level = 0

    @property
    def overload(self) -> str:
        """One sentence with a figure while the machine is overloaded, else empty."""
        return self._overload.told

    async def keep_looking(self) -> None:
        """Look until cancelled."""
        looked_s = time.monotonic()
        while True:
            began_s = time.monotonic()
            await asyncio.sleep(_TICK_S)
            now_s = time.monotonic()
            missed = max(round((now_s - began_s) / _TICK_S) - 1, 0)
            self._ticks = Tally(self._ticks.done + 1, self._ticks.missed + missed)
            if now_s - looked_s >= _LOOK_S:
                looked_s = now_s
                self.look(time.monotonic_ns())

    def look(self, now_ns: int) -> None:
        """Compare and tell what has changed."""
        before = self._overload.told
        told = self._overload.update(now_ns, {LOOP: self._ticks} | dict(self._counts()))
        if told and (not before or now_ns - self._told_ns >= _TELL_AGAIN_NS):
            self._told_ns = now_ns
            self._log.write("overloaded", "warning", cause="machine.overloaded", detail=told)
        elif before and not told:
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
            told = f"{directory}: {free_mb:.0f} MB left; below {DISK_FULL_MB:.0f} MB no motion is begun"
            self._log.write("disk_low", "warning", cause="recording.disk_low", detail=told)
        self._disk_level = level
