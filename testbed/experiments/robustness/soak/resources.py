"""Memory and file handles of processes over time, and whether they grow."""

import threading
import time
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import psutil

from foundation.statistics import resident_mb

PERIOD_S = 10.0
_LOOKS, _BETWEEN_S = 5, 0.2  # for a sample: the least counts, as a picture in work comes and goes


class ResourceSample(NamedTuple):
    """What a service and its children held at one time, pictures in work left out."""

    at_s: float
    memory_mb: float
    handles: int


class Growth(NamedTuple):
    """A straight line through the samples after the warm-up, by least squares.

    ``error_mb_per_h``: the slope's standard error if the samples scattered independently. ``handles_from``,
    ``handles_to``: medians of the first and the last fifth.
    """

    start_mb: float
    end_mb: float
    mb_per_h: float
    error_mb_per_h: float
    handles_from: float
    handles_to: float


def growth(samples: list[ResourceSample], warm_up_s: float) -> Growth:
    """How memory and handles grew after ``warm_up_s``. NaN where fewer than three samples are left."""
    if not samples:
        return Growth(*([float("nan")] * 6))
    late = [sample for sample in samples if sample.at_s >= warm_up_s]
    start, end = samples[0].memory_mb, samples[-1].memory_mb
    if len(late) < 3:
        return Growth(start, end, *([float("nan")] * 4))
    hours = np.array([sample.at_s / 3600.0 for sample in late])
    memory = np.array([sample.memory_mb for sample in late])
    hours -= hours.mean()
    spread = float(hours @ hours)
    slope = float(hours @ memory) / spread
    residual = memory - memory.mean() - slope * hours
    error = float(np.sqrt(residual @ residual / (len(late) - 2) / spread))
    fifth = max(len(late) // 5, 1)
    handles = [sample.handles for sample in late]
    return Growth(
        start, end, slope, error, float(np.median(handles[:fifth])), float(np.median(handles[-fifth:]))
    )


class ResourceWatch(threading.Thread):
    """Samples every process in ``pids`` (name → number) with its children every ten seconds, until ended."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        super().__init__(daemon=True)
        self._pids = pids
        self._ended = threading.Event()
        self._began_s = time.monotonic()
        self.samples: dict[str, list[ResourceSample]] = {name: [] for name in pids}

    def run(self) -> None:
        """The thread's work."""
        while True:
            families = {name: _family(pid) for name, pid in self._pids.items()}
            held = _held(families)
            for _ in range(_LOOKS - 1):
                if not self._ended.wait(_BETWEEN_S):
                    now = _held(families)
                    held = {name: min(held[name], now[name]) for name in held}
            at_s = time.monotonic() - self._began_s
            for name, family in families.items():
                self.samples[name].append(ResourceSample(at_s, held[name], sum(map(_handles, family))))
            if self._ended.wait(PERIOD_S - _LOOKS * _BETWEEN_S):
                return

    def end(self) -> None:
        """Take a last sample and end."""
        self._ended.set()
        self.join()


def _held(families: Mapping[str, list[psutil.Process]]) -> dict[str, float]:
    return {name: sum(resident_mb(each.pid) for each in family) for name, family in families.items()}


def _family(pid: int) -> list[psutil.Process]:
    try:
        first = psutil.Process(pid)
        return [first, *first.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _handles(process: psutil.Process) -> int:
    try:
        return int(process.num_fds())
    except psutil.Error:
        return 0  # ended while we looked
