"""Real processes for the integration tests, on free ports."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import httpx

from testbed.realtime.launch import Launch, prepare
from testbed.realtime.supervisor import Supervisor, supervised
from testbed.scenarios.scenario import chosen_overrides
from tests.support.paths import CONFIGS

HEALTHY_S = 120.0


class Running(NamedTuple):
    """Services that run, and vision's REST face."""

    launch: Launch
    supervisor: Supervisor
    face: httpx.Client


@contextmanager
def running(
    directory: Path,
    *assignments: str,
    only: tuple[str, ...] = (),
    foxglove: int | None = None,
    recorded: bool = True,
) -> Iterator[Running]:
    """All three services (or ``only`` some) with free ports and the standard world of seed 1."""
    overrides = chosen_overrides(CONFIGS, "standard", 1, list(assignments))
    launch = prepare(CONFIGS, overrides, directory, any_ports=True, foxglove=foxglove)
    services = [service for service in launch.services if not only or service.name in only]
    if not recorded:
        services = [each._replace(arguments=_without_recording(each.arguments)) for each in services]
    with (
        supervised(services, directory) as supervisor,
        httpx.Client(base_url=launch.rest_url, timeout=10.0) as face,
    ):
        yield Running(launch, supervisor, face)


def _without_recording(options: tuple[str, ...]) -> tuple[str, ...]:
    if "--record-dir" not in options:
        return options
    at = options.index("--record-dir")
    return (*options[:at], *options[at + 2 :])


def until_healthy(rig: Running) -> None:
    """Return once vision has pictures and a session."""
    until_s = time.monotonic() + HEALTHY_S
    while rig.face.get("/health").status_code != httpx.codes.OK:
        assert time.monotonic() < until_s, rig.face.get("/health").text
        time.sleep(0.5)
