"""Memory and file handles of processes over time, and whether they grow."""

import math
import threading
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import psutil

from foundation.self_watch import resident_mb
from laboratory.campaigns.experiment import Check, at_most
from testbed.realtime.launch import CONTROLLER, PLANT
from testbed.reporting.console import out, table

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
            held = _resident_by_family(families)
            for _ in range(_LOOKS - 1):
                if not self._ended.wait(_BETWEEN_S):
                    now = _resident_by_family(families)
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


def _resident_by_family(families: Mapping[str, list[psutil.Process]]) -> dict[str, float]:
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


OVERRUNS_WANTED_PERCENT = 0.5
GROWTH_WANTED_MB_PER_H = 1.0
LONG_ENOUGH_MIN = 30.0  # shorter soaks cannot tell a leak from the spread of their samples
_SHOWN_INCIDENTS = 10


def checks(figures: dict[str, Any]) -> list[Check]:
    """Overruns, refusals that no fault explains, growth of memory and handles, and what ended it."""
    long_enough = figures["minutes"] >= LONG_ENOUGH_MIN
    made = [
        Check("ended by", figures["ended_by"] or "the clock", "the clock", not figures["ended_by"]),
        at_most("controller's scans that were late", figures["controller"]["overruns_percent"],
                OVERRUNS_WANTED_PERCENT, "%"),
        at_most("incidents that neither a fault nor overload explains", figures["unexplained"], 0),
    ]  # fmt: skip
    for name, grown in figures["growth"].items():
        limit = GROWTH_WANTED_MB_PER_H if long_enough and math.isfinite(grown.mb_per_h) else None
        made.append(at_most(f"memory of {name}, growth after the warm-up", grown.mb_per_h, limit, "MB/h"))
        more = grown.handles_to - grown.handles_from
        made.append(
            at_most(f"file handles of {name}, growth after the warm-up", more, 0 if long_enough else None)
        )
    return made


def show(figures: dict[str, Any]) -> None:
    """Print every table."""
    _show_real_time(figures)
    _show_facts(figures)
    _show_memory(figures["growth"])
    _show_incidents(figures)


def _show_real_time(figures: dict[str, Any]) -> None:
    controller, plant = figures["controller"], figures["plant"]
    integrator, scheduling = plant["integrator"], figures["scheduling"]

    def late(source: dict[str, Any]) -> str:
        return "/".join(f"{source[f'late_{key}_us']:.0f}" for key in ("p50", "p99", "p999", "max"))

    rows = [
        ("controller", f"{controller['cycle_ms']:g} ms", scheduling[CONTROLLER], controller["cycles"],
         f"{controller['overruns']} ({controller['overruns_percent']:.3f} %)", late(controller)),
        ("plant", f"{plant['period_ms']:g} ms", scheduling[PLANT], integrator["periods_served"],
         f"{integrator['periods_missed']} ({integrator['missed_percent']:.3f} %)", late(integrator)),
    ]  # fmt: skip
    columns = ("task", "period", "scheduling", "cycles", "overruns", "late p50/p99/p99.9/max µs")
    out.print(table(f"real time over {figures['minutes']:.1f} minutes", columns, rows))


def _show_facts(figures: dict[str, Any]) -> None:
    controller, camera, scheduling = figures["controller"], figures["plant"]["camera"], figures["scheduling"]
    vision, polls, recoveries = figures["vision"], figures["polls"], figures["recoveries"]
    trip = "/".join(f"{controller[f'round_trip_{key}_us']}" for key in ("p50", "p99", "p999"))
    scan = "/".join(f"{controller[f'scan_{key}_us']}" for key in ("p50", "p99", "p999"))
    failures = sum(controller["plant_exchange_failures"].values())
    facts = [
        ("frames rendered", camera["frames_rendered"]),
        ("frames dropped (renderer, stream, vision)",
         f"{camera['frames_skipped'] + camera['poses_dropped']}, {camera['frames_dropped_slow']}, "
         f"{vision['camera']['dropped']}"),
        ("frames received by vision", vision["camera"]["frames"]),
        ("fieldbus exchanges, failed", f"{controller['plant_exchanges']}, {failures}"),
        ("fieldbus round trip p50/p99/p99.9 µs", trip),
        ("scan p50/p99/p99.9 µs", scan),
        ("renderer, vision's thread", f"{scheduling['renderer']}, {vision['scheduling']}"),
        ("operations done", ", ".join(f"{count} {kind}" for kind, count in figures["operations"].items())),
        ("polls of the state; answered in p50/p99/max ms",
         f"{polls['count']}; {polls['p50_ms']:.1f}/{polls['p99_ms']:.1f}/{polls['max_ms']:.0f}"),
        ("operations followed, events seen", ", ".join(
            f"{each['operations']}, {each['events']}" for each in figures["followers"])),
        ("faults injected", len(figures["faults"])),
        ("times that a service told of overload", figures["overloads"]),
        ("times enabled again, longest wait", f"{recoveries['count']}, {recoveries['longest_s']:.1f} s"),
    ]  # fmt: skip
    out.print(table("pictures, fieldbus, clients", ("what", "figure"), facts))


def _show_memory(growths: dict[str, Growth]) -> None:
    rows = [
        (name, f"{grown.start_mb:.1f}", f"{grown.end_mb:.1f}",
         f"{grown.mb_per_h:+.2f} ± {grown.error_mb_per_h:.2f}",
         f"{grown.handles_from:.0f}", f"{grown.handles_to:.0f}")
        for name, grown in growths.items()
    ]  # fmt: skip
    columns = ("service", "MB at start", "MB at end", "MB/h after warm-up", "handles then", "handles at end")
    out.print(table("memory and file handles, children included", columns, rows))


def _show_incidents(figures: dict[str, Any]) -> None:
    if figures["incident_counts"]:
        columns = ("who", "cause", "explained by", "times")
        rows = [(who, cause, by or "NOTHING", count) for who, cause, by, count in figures["incident_counts"]]
        out.print(table("incidents", columns, rows))
    unexplained = [i for i in figures["incidents"] if not i["explained_by"]]
    for incident in unexplained[:_SHOWN_INCIDENTS]:
        told = f"at {incident['at_s']:.1f} s {incident['who']}: {incident['cause']}: {incident['detail']}"
        out.print(told, markup=False, highlight=False, soft_wrap=True)
