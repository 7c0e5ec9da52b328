"""`longreach soak`: all three services for minutes to hours, looking, moving, polled, followed, broken.

What it prints comes from the services' own statistics, from the kernel's account of their memory and handles,
and from what its own clients met. An incident is counted and the soak goes on; only the end of a service, or
an arm that cannot be enabled again, ends it early, with the figures so far.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from foundation.secret_source import read_secret
from laboratory.campaigns.experiment import show_checks
from laboratory.soak.duty import FOLLOWERS, Duty, Follower, Poller
from laboratory.soak.incidents import Journal, RandomFaults
from laboratory.soak.resources import Growth, ResourceWatch, checks, growth, show
from protocol.errors import LongreachError
from testbed.realtime.launch import CONTROLLER, PLANT, VISION, Launch, prepare
from testbed.realtime.rest_rig import RestRig
from testbed.realtime.up import end_on_sigterm, started
from testbed.reporting.console import bars, err, write_json
from testbed.reporting.run_directory import run_directory
from testbed.reporting.run_record import note, note_settings
from testbed.scenarios.scenario import Overrides, with_face

_HEALTHY_S = 60.0
_WARM_UP_SHARE = 1 / 3  # of the time: caches fill, and vision keeps its last 200 operations


class _Companion(Protocol):
    """What runs beside the work in a thread of its own."""

    def start(self) -> None: ...

    def end(self) -> None: ...


class SoakRequest(NamedTuple):
    """How long, in minutes; with faults at random times, drawn by ``seed``; with which services."""

    minutes: float
    faults: bool
    seed: int
    config_dir: Path
    overrides: Overrides
    any_ports: bool
    runs: Path


def run_soak(request: SoakRequest, json_file: Path | None) -> bool:
    """Whether every limit was kept; prints and writes all figures.

    Raises LongreachError when the services do not start.
    """
    end_on_sigterm()
    overrides = with_face(request.overrides, request.faults)
    with run_directory(request.runs) as directory:
        launch = prepare(request.config_dir, overrides, directory, any_ports=request.any_ports)
        note_settings(directory, launch.settings)
        figures = _soak_figures(launch, request)
        show(figures)
        verdict = checks(figures)
        show_checks(verdict)
        missed = ", ".join(check.what for check in verdict if check.met is False)
        note(directory, seed=request.seed, verdict=f"not met: {missed}" if missed else "all limits met")
        figures["checks"] = [check._asdict() for check in verdict]
        write_json(launch.directory / "soak.json", figures)
    write_json(json_file, figures)
    return all(check.met is not False for check in verdict)


def _soak_figures(launch: Launch, request: SoakRequest) -> dict[str, Any]:
    """All figures of a soak."""
    seconds = 60.0 * request.minutes
    ended_by = ""
    with bars() as shown, started(launch, shown) as supervisor, _rig(launch) as rig:
        with shown.step("waiting for links and camera"):
            rig.wait_healthy(_HEALTHY_S)
        ready = {name: child.ready or {} for name, child in supervisor.children.items()}
        journal = Journal()
        watch = ResourceWatch({name: child.pid for name, child in supervisor.children.items()})
        poller, *followers = _readers(launch, journal)
        clients: list[_Companion] = [watch, poller, *followers, *_faults(launch, request, journal)]
        with shown.step(f"soaking for {request.minutes:g} minutes") as bar:
            duty = Duty(rig, journal, bar, supervisor.check)
            for client in clients:
                client.start()
            try:
                duty.keep(seconds, _WARM_UP_SHARE * seconds)
                rig.command("disable")
            except LongreachError as error:
                ended_by = str(error)
                err.print(f"the soak ended early: {ended_by}", markup=False)
            for client in reversed(clients):
                client.end()
    journal.read_overloads(launch.directory / f"{name}.log" for name in watch.samples)
    recoveries = duty.recoveries_s[1:]
    return _statistics(launch, ready) | _of_clients(poller, followers) | _of_incidents(journal) | {
        "minutes": journal.now_s / 60.0,
        "ended_by": ended_by,
        "operations": dict(duty.done),
        "recoveries": {"count": len(recoveries), "longest_s": max(recoveries, default=0.0)},
        "growth": _growth(watch, seconds),
        "directory": launch.directory,
    }  # fmt: skip


def _of_clients(poller: Poller, followers: list[Follower]) -> dict[str, Any]:
    half, high, top = poller.percentiles_ms()
    return {
        "polls": {"count": len(poller.waits_ms), "p50_ms": half, "p99_ms": high, "max_ms": top},
        "followers": [{"operations": each.followed, "events": each.events} for each in followers],
    }


def _of_incidents(journal: Journal) -> dict[str, Any]:
    return {
        "faults": [fault._asdict() for fault in journal.faults],
        "overloads": len(journal.overloads),
        "incidents": [incident._asdict() for incident in journal.incidents],
        "incident_counts": [(*key, count) for key, count in sorted(journal.counts().items())],
        "unexplained": len(journal.unexplained),
    }


def _readers(launch: Launch, journal: Journal) -> tuple[Poller, *tuple[Follower, ...]]:
    api = launch.rest_url, launch.rest_token()
    return Poller(*api, journal), *(Follower(*api, journal) for _ in range(FOLLOWERS))


def _faults(launch: Launch, request: SoakRequest, journal: Journal) -> list[RandomFaults]:
    api = launch.settings.plant_service.fault_face
    if not request.faults:
        return []
    token = read_secret(api.tokens.operate, "operate token")
    return [RandomFaults(f"http://{api.host}:{api.port}", token, journal, request.seed)]


@contextmanager
def _rig(launch: Launch) -> Iterator[RestRig]:
    rig = RestRig(launch.rest_url, launch.rest_token())
    try:
        yield rig
    finally:
        rig.close()


def _growth(watch: ResourceWatch, seconds: float) -> dict[str, Growth]:
    return {name: growth(samples, _WARM_UP_SHARE * seconds) for name, samples in watch.samples.items()}


def _statistics(launch: Launch, ready: dict[str, Any]) -> dict[str, Any]:
    """The services' own figures, read after their end; of a killed one those of its last ten seconds."""
    read = {name: json.loads(launch.statistics(name).read_text()) for name in (PLANT, CONTROLLER, VISION)}
    return {
        "controller": read[CONTROLLER],
        "plant": read[PLANT],
        "vision": read[VISION],
        "scheduling": {name: fields.get("scheduling", "") for name, fields in ready.items()}
        | {"renderer": ready[PLANT].get("renderer_scheduling", "")},
    }
