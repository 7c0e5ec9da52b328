"""``longreach experiment robustness --method attacks``: what strangers can do to running services."""

import contextlib
import http.client
import multiprocessing
import resource
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import psutil
from rich.table import Table
from typer import Option

from foundation.configuration import merged, parse_overrides
from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished
from laboratory.campaigns.options import Assignments
from laboratory.experiments.robustness.strangers import ATTACKS, Listeners
from protocol.errors import LongreachError
from testbed.realtime.launch import VISION, Launch, prepare
from testbed.realtime.rest_rig import RestRig
from testbed.realtime.supervisor import supervised
from testbed.reporting.console import bars, table
from vision_pc.application.results import JSON

NONE = "none"
STOP_P99_MS = 250.0  # over HTTP, connection included, on a machine that the attacker shares
GROWTH_MB = 100.0  # 256 connections of 256 KB each, and what pictures take


class AttackSettings(NamedTuple):
    """Which attacks, and on which services."""

    only: Annotated[list[str] | None, Option("--only", help="This attack alone; repeatable.")] = None
    windows: Annotated[int, Option(help="How often each is tried, peace and attacks in turn.", min=1)] = 1
    assignments: Assignments = None


class AttackRow(NamedTuple):
    """What became of a motion, of stops and of the controller's periods while one attack went on.

    ``stop_ms``: each POST /stop, from the connection to the answer. ``links_lost``: how often the reference
    link was. ``growth_mb``: of the vision PC's memory, at most. ``answers``: what the attacker got.
    """

    attack: str
    motion: str
    stops: int
    stops_failed: int
    stop_ms: list[float]
    scans: int
    overruns: int
    exchange_failures: int
    links_lost: int
    growth_mb: float
    answers: dict[str, int]
    failure: str

    def percentile_ms(self, percent: float) -> float:
        """Within how long so many of the stops were answered; NaN where none was asked for."""
        return float(np.percentile(self.stop_ms, percent)) if self.stop_ms else float("nan")


Attacked = Finished[AttackSettings, AttackRow]


def attack_tasks(request: CampaignRequest, settings: AttackSettings) -> list[Task]:
    """One task an attack, that of none first. Real time is never measured already."""
    begun = time.strftime("%Y%m%d-%H%M%S")
    chosen = [name for name in ATTACKS if name == NONE or name in (settings.only or ATTACKS)]
    directory = request.out.absolute() / begun
    asked = {"assignments": settings.assignments or []}
    keys = [(f"{name}-{window}", name) for window in range(settings.windows) for name in chosen]
    return [{"key": f"{begun} {k}", "attack": n, "directory": str(directory / k)} | asked for k, n in keys]


def attack_table(done: Attacked) -> list[Table]:
    """A line for each attack, all its windows together."""
    lines: list[Sequence[Any]] = []
    for attack in dict.fromkeys(row.attack for row in done.rows):
        rows = [row for row in done.rows if row.attack == attack and not row.failure]
        if not rows:
            continue
        stops = [ms for row in rows for ms in row.stop_ms]
        waits = "/".join(f"{np.percentile(stops, p):.0f}" if stops else "-" for p in (50, 99, 100))
        got = Counter[str]()
        for row in rows:
            got.update(row.answers)
        lines.append(
            (attack, f"{sum(row.motion == 'succeeded' for row in rows)} of {len(rows)}",
             f"{sum(row.stops_failed for row in rows)} of {len(stops)}", waits,
             f"{sum(row.overruns for row in rows)} of {sum(row.scans for row in rows)}",
             sum(row.exchange_failures for row in rows), sum(row.links_lost for row in rows),
             f"{max(row.growth_mb for row in rows):+.0f}",
             ", ".join(f"{n} {what}" for what, n in got.items()))
        )  # fmt: skip
    columns = ("attack", "motions done", "stops failed", "stop p50/p99/max ms", "scans late",
               "exchanges failed", "links lost", "memory MB", "what the attacker got")  # fmt: skip
    return [table(f"{SECONDS:g} s of each attack, from another process of this machine", columns, lines)]


def attack_verdict(done: Attacked) -> list[Check]:
    """No attack ends a motion, fails or delays a stop, or fails an exchange."""
    rows = [row for row in done.rows if not row.failure and row.attack != NONE]
    moved = [row.attack for row in rows if row.motion != "succeeded"]
    unstopped = [row.attack for row in rows if row.stops_failed or not row.stops]
    late = [row.attack for row in rows if not row.percentile_ms(99) <= STOP_P99_MS]
    missed = [row.attack for row in rows if row.exchange_failures]
    in_peace = max((row.links_lost for row in done.rows if row.attack == NONE), default=0)
    lost = [row.attack for row in rows if row.links_lost > in_peace]
    grown = [row.attack for row in rows if row.growth_mb > GROWTH_MB]
    return [
        _none("attacks that could not be tried", [row.attack for row in done.rows if row.failure]),
        _none("attacks that ended a motion", moved),
        _none("attacks under which a stop was not accepted", unstopped),
        _none(f"attacks under which the p99 of stops was above {STOP_P99_MS:g} ms", late),
        _none("attacks under which a fieldbus exchange failed", missed),
        _none("attacks under which the link was lost more often than in peace", lost),
        _none(f"attacks that grew the vision PC by more than {GROWTH_MB:g} MB", grown),
    ]


def _none(what: str, found: list[str]) -> Check:
    return Check(what, ", ".join(found) or "none", "none", not found)


SECONDS = 15.0  # of attack: a motion, then stops
_STOP_EVERY_S = _TURN_S = 0.05
_STROKE_M = 0.1
_HEALTHY_S = 60.0
_PATIENCE_S = 10.0


class Counters(NamedTuple):
    """What the controller has counted since its start."""

    scans: int
    overruns: int
    exchange_failures: int


def one_trial(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """The row of one attack, the services started for it alone; logs and records in ``directory``."""
    overrides = merged(parse_overrides(task["assignments"]), {})
    launch = prepare(config_dir, overrides, Path(task["directory"]), any_ports=True)
    with bars() as shown, supervised(launch.services, launch.directory) as services:
        rig = RestRig(launch.rest_url)
        try:
            rig.wait_healthy(_HEALTHY_S)
            rig.command("enable")
            with shown.step(task["attack"]) as bar:
                vision = psutil.Process(services.children[VISION].pid)
                return {"attack": task["attack"]} | _run_attack(launch, rig, vision, task["attack"], bar)
        finally:
            rig.close()


def _run_attack(
    launch: Launch, rig: RestRig, vision: psutil.Process, attack: str, bar: Any
) -> dict[str, Any]:
    rig.operate("move", {"offset_base_m": [0.0, _STROKE_M, 0.0]}, bar)  # something to follow
    before, lost = _counters(rig.state()), _links_lost(launch)
    context = multiprocessing.get_context("spawn")
    with context.Pool(1, _many_files) as strangers, _growth_mb(vision) as growth_mb:
        running = strangers.apply_async(_run, (attack, _listeners(launch), SECONDS))
        until_s = time.monotonic() + SECONDS
        time.sleep(1.0)  # the attack is under way
        motion = _move_outcome(rig, bar)
        waits_ms, failed = _stops(launch, until_s)
        counts = running.get(SECONDS + _PATIENCE_S)
    after = _counters(_patiently(rig.state))
    return {
        "motion": motion,
        "stops": len(waits_ms),
        "stops_failed": failed,
        "stop_ms": waits_ms,
        "scans": after.scans - before.scans,
        "overruns": after.overruns - before.overruns,
        "exchange_failures": after.exchange_failures - before.exchange_failures,
        "links_lost": _links_lost(launch) - lost,
        "growth_mb": max(growth_mb),
        "answers": dict(counts),
    }


@contextlib.contextmanager
def _growth_mb(process: psutil.Process) -> Iterator[list[float]]:
    """By how much the memory of ``process`` has grown since, MB, sampled while the block lasts."""
    begin, samples, done = process.memory_info().rss, [0.0], threading.Event()

    def sample() -> None:
        while not done.wait(_TURN_S):
            samples.append(1e-6 * (process.memory_info().rss - begin))

    thread = threading.Thread(target=sample, daemon=True)
    thread.start()
    try:
        yield samples
    finally:
        done.set()
        thread.join()


def _links_lost(launch: Launch) -> int:
    log = launch.directory / f"{VISION}.log"
    return log.read_text(encoding="utf-8", errors="replace").count('"link_lost"')


def _move_outcome(rig: RestRig, bar: Any) -> str:
    """How a motion ended: "succeeded", or the cause."""
    try:
        rig.operate("move", {"offset_base_m": [0.0, -_STROKE_M, 0.0]}, bar)
    except LongreachError as error:
        return error.cause
    return "succeeded"


def _stops(launch: Launch, until_s: float) -> tuple[list[float], int]:
    """How long (ms) each POST /stop took, connection included, and how many were not accepted."""
    waits_ms, failed = [], 0
    api = launch.settings.vision.api
    while time.monotonic() < until_s:
        begin_s = time.monotonic()
        connection = http.client.HTTPConnection(api.host, api.port, timeout=_PATIENCE_S)
        try:
            connection.request("POST", "/stop")
            accepted = connection.getresponse().status == http.HTTPStatus.OK
        except (OSError, http.client.HTTPException):
            accepted = False
        finally:
            connection.close()
        waits_ms.append(1e3 * (time.monotonic() - begin_s))
        failed += not accepted
        time.sleep(_STOP_EVERY_S)
    return waits_ms, failed


def _patiently(state: Callable[[], JSON]) -> JSON:
    """The state once it is given again, when the attack has just ended."""
    until_s = time.monotonic() + _PATIENCE_S
    while True:
        try:
            return state()
        except LongreachError:
            if time.monotonic() > until_s:
                raise
            time.sleep(_STOP_EVERY_S)


def _counters(state: JSON) -> Counters:
    cycle = state["cycle"]
    return Counters(cycle["count"], cycle["overruns"], cycle["plant_exchange_failures"])


def _listeners(launch: Launch) -> Listeners:
    plant, api = launch.settings.plant_service, launch.settings.vision.api
    link = launch.settings.controller.reference_link
    ends = (api, plant.fault_face, plant.modbus, plant.camera_stream, link)
    return Listeners(*((end.host, end.port) for end in ends))


def _many_files() -> None:
    """Let this process hold as many connections as the machine allows."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _run(attack: str, listeners: Listeners, seconds: float) -> dict[str, int]:
    return dict(ATTACKS[attack](listeners, seconds))


ATTACKS_EXPERIMENT = Experiment(
    name="attacks",
    title="Attack every listener of the running services, as a stranger can.",
    settings=AttackSettings,
    row=AttackRow,
    tasks=attack_tasks,
    run=one_trial,
    table=attack_table,
    verdict=attack_verdict,
    world="the three services as processes, started anew for every attack",
    eyes="rendered pictures",
    workers=0,
)
