"""`longreach soak`: all three services for minutes, at rest and in motion, with vision looking all the while.

What it prints comes from the services' own statistics and from the kernel's account of their memory.
"""

import json
import time
from pathlib import Path
from typing import Any

from foundation.statistics import resident_mb
from protocol.errors import LongreachError
from testbed.realtime.launch import CONTROLLER, PLANT, VISION, Launch, prepare
from testbed.realtime.rest_rig import JSON, RestRig
from testbed.realtime.supervisor import Supervisor
from testbed.realtime.up import end_on_sigterm, started
from testbed.reporting.console import Bar, bars, out, table, write_json
from testbed.reporting.report import run_directory
from testbed.scenarios.settings import Overrides

_HEALTHY_S = 60.0
_LOOK_FRAMES = 50  # five seconds of looking at 10 pictures a second
_STROKE_M = 0.15
OVERRUNS_WANTED_PERCENT = 0.5


def run_soak(
    config_dir: Path,
    overrides: Overrides,
    minutes: float,
    any_ports: bool,
    runs: Path,
    json_file: Path | None,
) -> bool:
    """Whether overruns stayed under half a percent; prints and writes all figures.

    Raises LongreachError when a service fails, or refuses to move or look.
    """
    end_on_sigterm()
    with run_directory(runs) as directory:
        launch = prepare(config_dir, overrides, directory, any_ports=any_ports)
        figures = _soaked(launch, minutes)
        _show(figures)
        write_json(launch.directory / "soak.json", figures)
    write_json(json_file, figures)
    return bool(figures["controller"]["overruns_percent"] < OVERRUNS_WANTED_PERCENT)


def _soaked(launch: Launch, minutes: float) -> dict[str, Any]:
    """All figures of a soak."""
    with bars() as shown, started(launch, shown) as supervisor:
        rig = RestRig(launch.rest_url)
        try:
            with shown.step("waiting for links and camera"):
                rig.wait_healthy(_HEALTHY_S)
            ready = {name: child.ready or {} for name, child in supervisor.children.items()}
            before = memory_mb(supervisor)
            with shown.step(f"soaking for {minutes:g} minutes") as bar:
                done = _keep_busy(rig, supervisor, minutes * 60.0, bar)
            after = memory_mb(supervisor)
        finally:
            rig.close()
    return gathered(launch, ready) | {
        "minutes": minutes,
        "operations": done,
        "memory_mb": {name: {"start": before[name], "end": after[name]} for name in before},
        "directory": launch.directory,
    }


def _keep_busy(rig: RestRig, supervisor: Supervisor, seconds: float, bar: Bar) -> dict[str, int]:
    """How often each operation was done: rest and motion in turns, pictures analysed in both."""
    done = {"look": 0, "move": 0, "trajectory-matching": 0}
    began = time.monotonic()
    overall = _Overall(bar, began, seconds)
    rig.command("enable")
    stroke = _STROKE_M
    while time.monotonic() - began < seconds:
        for kind, body in _round(stroke):
            if time.monotonic() - began >= seconds:
                break
            try:
                rig.operate(kind, body, overall)
            except LongreachError:
                supervisor.check()
                raise
            done[kind] += 1
        stroke = -stroke
    rig.command("disable")
    return done


def _round(stroke: float) -> tuple[tuple[str, JSON], ...]:
    return (
        ("look", {"frames": _LOOK_FRAMES}),
        ("move", {"offset_base_m": [0.0, stroke, 0.0]}),
        ("look", {"frames": _LOOK_FRAMES}),
        ("trajectory-matching", {}),
    )


class _Overall(Bar):
    """Shows the time of the whole soak, whatever the running operation reports of itself."""

    def __init__(self, bar: Bar, began: float, seconds: float) -> None:
        self._bar = bar
        self._began = began
        self._seconds = seconds

    def update(self, fraction: float, note: str = "") -> None:
        """Set the bar to the share of the time that has passed."""
        self._bar.update((time.monotonic() - self._began) / self._seconds, note)


def gathered(launch: Launch, ready: dict[str, JSON]) -> dict[str, Any]:
    """The services' own figures, read after their end."""
    read = {name: json.loads(launch.statistics(name).read_text()) for name in (PLANT, CONTROLLER, VISION)}
    return {
        "controller": read[CONTROLLER],
        "plant": read[PLANT],
        "vision": read[VISION],
        "scheduling": {name: fields.get("scheduling", "") for name, fields in ready.items()}
        | {"renderer": ready[PLANT].get("renderer_scheduling", "")},
    }


def memory_mb(supervisor: Supervisor) -> dict[str, float]:
    """Resident memory (MB) of each service with its own children."""
    parents = _parents()
    result = {}
    for name, child in supervisor.children.items():
        family = {child.pid}
        while grown := {pid for pid, parent in parents.items() if parent in family} - family:
            family |= grown
        result[name] = sum(map(resident_mb, family))
    return result


def _parents() -> dict[int, int]:
    parents = {}
    for directory in Path("/proc").iterdir():
        if directory.name.isdigit():
            try:
                fields = (directory / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue  # ended while we looked
            parents[int(directory.name)] = int(fields[1])
    return parents


def _show(figures: dict[str, Any]) -> None:
    controller, plant = figures["controller"], figures["plant"]
    integrator, camera = plant["integrator"], plant["camera"]
    scheduling = figures["scheduling"]

    def late(source: JSON) -> str:
        return "/".join(f"{source[f'late_{key}_us']:.0f}" for key in ("p50", "p99", "p999", "max"))

    rows = [
        ("controller", f"{controller['cycle_ms']:g} ms", scheduling[CONTROLLER], controller["cycles"],
         f"{controller['overruns']} ({controller['overruns_percent']:.3f} %)", late(controller)),
        ("plant", f"{plant['period_ms']:g} ms", scheduling[PLANT], integrator["periods_served"],
         f"{integrator['periods_missed']} ({integrator['missed_percent']:.3f} %)", late(integrator)),
    ]  # fmt: skip
    columns = ("task", "period", "scheduling", "cycles", "overruns", "late p50/p99/p99.9/max µs")
    out.print(table(f"real time over {figures['minutes']:g} minutes", columns, rows))
    trip = "/".join(f"{controller[f'round_trip_{key}_us']}" for key in ("p50", "p99", "p999"))
    scan = "/".join(f"{controller[f'scan_{key}_us']}" for key in ("p50", "p99", "p999"))
    failures = sum(controller["plant_exchange_failures"].values())
    facts = [
        ("frames rendered", camera["frames_rendered"]),
        ("frames dropped (renderer, stream, vision)",
         f"{camera['frames_skipped'] + camera['poses_dropped']}, {camera['frames_dropped_slow']}, "
         f"{figures['vision']['camera']['dropped']}"),
        ("frames received by vision", figures["vision"]["camera"]["frames"]),
        ("fieldbus exchanges, failed", f"{controller['plant_exchanges']}, {failures}"),
        ("fieldbus round trip p50/p99/p99.9 µs", trip),
        ("scan p50/p99/p99.9 µs", scan),
        ("renderer, vision's thread", f"{scheduling['renderer']}, {figures['vision']['scheduling']}"),
        ("operations done", ", ".join(f"{count} {kind}" for kind, count in figures["operations"].items())),
    ]  # fmt: skip
    facts += [
        (f"memory of {name}, start → end", f"{used['start']:.0f} → {used['end']:.0f} MB")
        for name, used in figures["memory_mb"].items()
    ]
    out.print(table("pictures, fieldbus, memory", ("what", "figure"), facts))
