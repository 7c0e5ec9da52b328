"""A service killed within a motion, three processes: it alone is started anew, nothing moves by itself."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from testbed.realtime.launch import CONTROLLER, PLANT, VISION, prepare
from testbed.realtime.supervisor import supervised
from testbed.scenarios.scenario import chosen_overrides
from tests.support.crash_trials import READY_S, Rig, judge, trials
from tests.support.paths import CONFIGS

MORE_THAN_ALL = 100  # crashes: the trials come quicker than crashes of one cause
SERVICES = (PLANT, CONTROLLER, VISION)


@contextmanager
def watched(directory: Path) -> Iterator[Rig]:
    """Three services under a supervisor that watches in a thread."""
    launch = prepare(CONFIGS, chosen_overrides(CONFIGS, "standard", 1, []), directory, any_ports=True)
    done = threading.Event()
    with (
        supervised(launch.services, directory, most_crashes=MORE_THAN_ALL) as supervisor,
        httpx.Client(base_url=launch.rest_url, timeout=90.0) as face,
    ):

        def watch() -> None:
            while not done.is_set():
                supervisor.watch(0.2, interval_s=0.05, tell=lambda _at_s, _said: None)

        watcher = threading.Thread(target=watch)
        watcher.start()
        children = supervisor.children
        try:
            yield Rig(
                face,
                kill=lambda name: os.kill(children[name].pid, signal.SIGKILL),
                identities=lambda: {name: child.pid for name, child in children.items()},
                serves=lambda name: children[name].ready is not None,
            )
        finally:
            done.set()
            watcher.join(READY_S)


@pytest.mark.processes
@pytest.mark.slow("three services start, and each of them once more")
@pytest.mark.timeout(400)
def test_each_killed_service_is_started_anew_alone_and_the_arm_stays_disabled(tmp_path: Path) -> None:
    with watched(tmp_path) as rig:
        for service in SERVICES:
            judge(*trials(rig, service, 1))
