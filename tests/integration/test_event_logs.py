"""What three real services write: log lines of one schema, statistics signed with their service's name."""

import json
import socket
import time
from pathlib import Path

import pytest

from testbed.realtime.launch import CONTROLLER, PLANT, VISION
from testbed.realtime.rest_rig import RestRig
from tests.integration.services import running
from tests.support.log_lines import assert_obeys

pytestmark = pytest.mark.realtime


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
        launch = rig.launch
    events: dict[str, set[str]] = {}
    for service in (PLANT, CONTROLLER, VISION):
        lines = [json.loads(line) for line in (tmp_path / f"{service}.log").read_text().splitlines()]
        for line in lines:
            assert_obeys(line, service)
        events[service] = {line["event"] for line in lines}
        assert "stopped" in events[service]
        assert json.loads(launch.statistics(service).read_text())["service"] == service
        assert not list(launch.statistics(service).parent.glob("*.part"))
    assert {"status", "frame_refused"} <= events[PLANT]
    assert {"plant_connected", "session_opened"} <= events[CONTROLLER]
    assert {"link_connected", "operation_queued", "look"} <= events[VISION]
