"""What three real services write: log lines of one schema, and statistics in the last of them."""

import json
import socket
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from testbed.realtime.launch import CONTROLLER, PLANT, VISION
from testbed.realtime.rest_rig import RestRig
from tests.integration.services import running
from tests.integration.test_live import TABLES
from tests.support.log_lines import assert_obeys

DERIVED = ("_percent", "_p50_us", "_p99_us", "_p999_us", "time_ns")

pytestmark = pytest.mark.processes


@pytest.mark.slow("three services start")
def test_lines_of_all_three_services_obey_one_schema(tmp_path: Path) -> None:
    with running(tmp_path) as rig:
        face = RestRig(rig.launch.rest_url)
        face.wait_healthy(60.0)
        face.close()
        assert rig.face.post("/enable").status_code == 200
        assert rig.face.post("/operations/look", json={"frames": 1}).status_code == 202
        ports = rig.launch.settings.plant_service
        with socket.create_connection(("127.0.0.1", ports.modbus.port), timeout=5.0) as bus:
            bus.sendall(b"no Modbus at all")
            bus.recv(64)
        time.sleep(1.0)
    events: dict[str, set[str]] = {}
    for service in (PLANT, CONTROLLER, VISION):
        lines = [json.loads(line) for line in (tmp_path / f"{service}.log").read_text().splitlines()]
        for line in lines:
            assert_obeys(line, service)
        events[service] = {line["event"] for line in lines}
        (stopped,) = [line for line in lines if line["event"] == "stopped"]
        left_out = [path for path in _leaves(stopped["statistics"]) if not _is_told(service, path)]
        assert left_out == [], "statistics that Prometheus is not told"
    assert {"status", "frame_refused"} <= events[PLANT]
    assert {"plant_connected", "session_opened"} <= events[CONTROLLER]
    assert {"link_connected", "operation_queued", "look"} <= events[VISION]


def _is_told(service: str, path: str) -> bool:
    table = TABLES[service]
    labelled = tuple(f"{figure.path}." for figure in table if figure.label)
    known = path in {figure.path for figure in table}
    return known or path.endswith(DERIVED) or path.startswith(labelled)


def _leaves(table: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{above}{key}.")
        elif isinstance(value, int | float):
            yield f"{above}{key}"
