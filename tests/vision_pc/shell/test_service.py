"""The vision PC as a process: ready line, exit statuses, a clean end; nobody else need be there."""

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from foundation.recording.contents import contents
from foundation.rest.guard import ANYBODY_HERE
from foundation.rest.problems import RefusalLog
from foundation.secret_source import bound_tcp
from testbed.realtime.launch import free_port
from tests.support.paths import CONFIGS
from vision_pc.__main__ import main
from vision_pc.shell.recording.vision_recorder import EVENT, FILE, LOG
from vision_pc.shell.stops.door_process import DoorProcess

pytestmark = pytest.mark.realtime


def arguments(*settings: str) -> list[str]:
    sets = [word for setting in settings for word in ("--set", setting)]
    return ["--config-dir", str(CONFIGS), *sets]


@pytest.mark.slow("the service starts as a process")
def test_it_says_ready_serves_and_ends_when_told(tmp_path: Path) -> None:
    port = free_port()
    settings = [
        f"vision.api.port={port}",
        f"vision.link.port={free_port()}",
        f"vision.camera.stream.port={free_port()}",
    ]
    command = [
        sys.executable,
        "-m",
        "vision_pc",
        *arguments(*settings),
        "--record-dir",
        str(tmp_path),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert ready["event"] == "ready"
        assert ready["rest"]["port"] == port
        health = httpx.get(f"http://127.0.0.1:{port}/health")
        assert health.status_code == 503
        assert health.json()["cause"] == "link.degraded"
        assert httpx.get(f"http://127.0.0.1:{port}/docs").status_code == 200
        metrics = httpx.get(f"http://127.0.0.1:{port}/metrics")
        assert metrics.headers["content-type"].startswith("text/plain; version=0.0.4")
        assert "longreach_vision_pc_link_connected 0.0\n" in metrics.text
        assert "longreach_vision_pc_recording_frames_missed_total 0.0\n" in metrics.text
        assert "longreach_vision_pc_controller_cycle" not in metrics.text
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()
        process.communicate()
    last = json.loads((tmp_path / "events.jsonl").read_text().splitlines()[-1])
    assert last["event"] == "stopped"
    figures = last["statistics"]
    assert figures["camera"]["connected"] is False
    assert 20.0 < figures["memory_mb"] < 1000.0
    recorded = contents(tmp_path / FILE)
    assert (recorded.complete, recorded.damages) == (True, ())
    assert figures["recording"]["written"] > 0
    counted = {topic.name for channel, topic in recorded.topics.items() if recorded.counts.get(channel)}
    assert counted == {EVENT, LOG}  # it heard of nobody and saw nothing


async def test_who_calls_before_the_door_has_started_waits_and_is_not_refused() -> None:
    listener = bound_tcp("127.0.0.1", 0, "vision.api")
    at = listener.getsockname()
    door = DoorProcess(listener, "nowhere", ANYBODY_HERE, None, RefusalLog(None))
    try:
        socket.create_connection(at, timeout=5.0).close()
    finally:
        door.close()


def test_a_sessions_directory_of_somebody_else_ends_it_with_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [*arguments(f"vision.api.port={free_port()}"), "--set", f"vision.sessions_dir={tmp_path}"]
    (tmp_path / "monday.json").write_text("{}")
    (tmp_path / "passwd").write_text("root")
    assert main(where) == 2
    told = capsys.readouterr().err
    assert told.startswith("vision_pc: configuration.sessions_dir_not_ours: ")
    assert told.endswith("passwd\n")
    assert main([*arguments(f"vision.api.port={free_port()}"), "--set", "vision.sessions_dir=/etc"]) == 2
