"""Real processes for the integration tests, on free ports."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import httpx

from testbed.choices import USUAL_TIMING, ClockKind, Timing
from testbed.realtime.launch import Launch, prepare
from testbed.realtime.supervisor import Supervisor, supervised
from testbed.scenarios.scenario import chosen_overrides
from tests.support.paths import CONFIGS


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
    by_wall: bool = False,
) -> Iterator[Running]:
    """All three services (or ``only`` some) with free ports and the standard world of seed 1."""
    overrides = chosen_overrides(CONFIGS, "standard", 1, list(assignments))
    # By the plant's clock all must be there.
    timing = Timing(ClockKind.WALL) if only or by_wall else USUAL_TIMING
    launch = prepare(CONFIGS, overrides, directory, any_ports=True, foxglove=foxglove, timing=timing)
    services = [service for service in launch.services if not only or service.name in only]
    if not recorded:
        services = [each._replace(arguments=_without_recording(each.arguments)) for each in services]
    with (
        supervised(services, directory) as supervisor,
        httpx.Client(base_url=launch.rest_url, timeout=90.0) as face,
    ):
        yield Running(launch, supervisor, face)


def _without_recording(options: tuple[str, ...]) -> tuple[str, ...]:
    if "--record-dir" not in options:
        return options
    at = options.index("--record-dir")
    return (*options[:at], *options[at + 2 :])
