"""``python -m plant_emulator`` as a process: serves, ends cleanly, refuses bad starts with one line."""

import contextlib
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from pyModbusTCP.client import ModbusClient

from foundation.recording.decoding import messages
from foundation.recording.messages import fields_of
from plant_emulator.__main__ import main
from plant_emulator.shell.truth_recorder import EVENT
from protocol.process_image import CONTROL_ENABLE, ValveImage, decode_sensors, encode_valves
from protocol.stereo_frame import HEADER_BYTES, decode_header
from testbed.recordings.plant_truth import read_truth
from tests.plant_emulator.camera.camera_world import CONFIGS
from tests.support.log_lines import assert_obeys

pytestmark = pytest.mark.realtime

ANY_PORTS = (
    "plant_service.modbus.port=0",
    "plant_service.camera_stream.port=0",
    "plant_service.fault_face.port=0",
)
READY_S = 60.0


def command(*arguments: str) -> list[str]:
    """The command line."""
    return [
        sys.executable, "-m", "plant_emulator", "--config-dir", str(CONFIGS), "--set", *ANY_PORTS, *arguments
    ]  # fmt: skip


@contextlib.contextmanager
def running(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """A plant that serves, and its ready line; ended at the latest when the block ends."""
    process = subprocess.Popen(
        command(*arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stdout is not None
        yield process, json.loads(process.stdout.readline())
    finally:
        process.terminate()
        if process.stderr is not None and not process.stderr.closed:
            process.communicate(timeout=10.0)


def receive_frame(sock: socket.socket) -> tuple[Any, bytes]:
    """Header and pixels of one frame."""

    def exactly(count: int) -> bytes:
        data = b""
        while len(data) < count:
            piece = sock.recv(count - len(data))
            assert piece
            data += piece
        return data

    header = decode_header(exactly(HEADER_BYTES))
    return header, exactly(header.payload_bytes)


def children(pid: int) -> list[int]:
    """Process numbers of the children of ``pid``."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def gone(pid: int, within_s: float) -> bool:
    """Whether a process that is not our child disappears in time."""
    limit = time.monotonic() + within_s
    while time.monotonic() < limit:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True
        time.sleep(0.02)
    return False


@pytest.mark.slow("a plant starts as processes")
def test_serves_moves_records_and_ends(tmp_path: Path) -> None:
    with running("--record-dir", str(tmp_path / "run")) as (process, ready):
        assert ready["event"] == "ready"
        assert ready["scheduling"] in ("fifo", "short_slice", "normal")
        master = ModbusClient("127.0.0.1", ready["modbus"]["port"], timeout=2.0, auto_open=True)
        with socket.create_connection(("127.0.0.1", ready["camera_stream"]["port"]), timeout=30.0) as stream:
            cycles = []
            for cycle in range(1, 60):
                image = ValveImage(cycle, CONTROL_ENABLE, (0.4, 0.0, 0.0, 0.0, 0.0, 0.0))
                words = master.write_read_multiple_registers(0x800, encode_valves(image), 0, 40)
                assert words is not None
                sensors = decode_sensors(words)
                assert sensors.echo_cycle == cycle
                cycles.append(sensors)
                time.sleep(0.005)
            frames = [receive_frame(stream) for _ in range(4)]
        assert cycles[-1].encoder_counts[0] - cycles[0].encoder_counts[0] > 100  # slew turns: positive valve
        assert cycles[-1].plant_cycle > cycles[0].plant_cycle
        headers = [header for header, _ in frames]
        ids = [header.frame_id for header in headers]
        assert ids == sorted(set(ids))
        assert all(header.send_ns > header.capture_ns for header in headers)
        assert frames[0][1] != frames[1][1]
        face = f"http://127.0.0.1:{ready['fault_face']['port']}/faults"
        assert httpx.get(face).json()["allowed"] is False
        refusal = httpx.post(face, json={"fault": {"kind": "supply_lost"}})
        assert (refusal.status_code, refusal.json()["cause"]) == (403, "refused.faults_not_allowed")
        time.sleep(0.3)  # no master writes: the plant's own watchdog must have closed the valves
        master.close()
        process.terminate()
        _, errors = process.communicate(timeout=READY_S)
        assert process.returncode == 0
    check_recording(
        tmp_path / "run" / "truth.mcap", {header.frame_id: header.capture_ns for header in headers}
    )
    figures = json.loads(errors.splitlines()[-1])["statistics"]
    assert figures["scheduling"] == ready["scheduling"]
    assert figures["integrator"]["periods_served"] > 300
    assert figures["coupler"]["requests"] == 59
    assert figures["camera"]["frames_sent"] >= 4
    assert figures["camera"]["frames_rendered"] >= 4
    assert figures["memory"]["plant_rss_mb"] > 10.0


@pytest.mark.slow("a plant starts as processes")
def test_faults_over_http_reach_fieldbus_camera_and_recording(tmp_path: Path) -> None:
    with running("--allow-faults", "--record-dir", str(tmp_path)) as (process, ready):
        assert ready["faults_allowed"] is True
        face = f"http://127.0.0.1:{ready['fault_face']['port']}/faults"
        address = ("127.0.0.1", ready["modbus"]["port"])
        with (
            socket.create_connection(address, timeout=5.0) as bus,
            socket.create_connection(("127.0.0.1", ready["camera_stream"]["port"]), timeout=30.0) as stream,
        ):
            ask = bytes.fromhex("000100000006010300000001")
            bus.sendall(ask)
            assert len(bus.recv(64)) == 11
            silence = httpx.post(face, json={"fault": {"kind": "coupler_silent"}}).json()
            bus.sendall(ask)
            bus.settimeout(0.5)
            with pytest.raises(TimeoutError):
                bus.recv(64)
            assert httpx.delete(f"{face}/{silence['number']}").status_code == 200
            bus.settimeout(5.0)
            bus.sendall(b"\x00\x02" + ask[2:])
            assert bus.recv(64)[:2] == b"\x00\x02"  # the swallowed request stays unanswered
            frozen = httpx.post(face, json={"fault": {"kind": "camera_frozen"}, "duration_s": 60}).json()
            frames = [receive_frame(stream) for _ in range(16)]  # the first ones had been sent before
        same = [a[1] == b[1] for a, b in itertools.pairwise(frames)]
        assert same[-3:] == [True, True, True]
        assert not same[0]
        assert len({header.frame_id for header, _ in frames}) == 16
        refusal = httpx.post(face, json={"fault": {"kind": "marker_covered", "marker_id": 9}})
        assert refusal.json()["cause"] == "refused.unknown_marker"
        restart = httpx.post(face.replace("/faults", "/world/restart"), timeout=READY_S)
        assert (restart.status_code, restart.json()) == (202, {"restarts": True})
        assert process.wait(READY_S) == 0
    recording = read_truth(tmp_path / "truth.mcap")
    assert recording.complete
    first, second = recording.faults
    assert (first.number, first.name, first.fault) == (1, "coupler_silent", {"kind": "coupler_silent"})
    assert first.began_ns is not None
    assert first.ended_ns is not None
    assert 4e8 < first.ended_ns - first.began_ns < 3e9
    assert (second.name, second.began_ns, second.ended_ns) == ("camera_frozen", frozen["start_ns"], None)
    assert any(record.truth.faults == ("coupler_silent",) for record in recording.truths)


def check_recording(path: Path, captured: dict[int, int]) -> None:
    """The recording is whole, dense, and names every frame received at its capture time."""
    recording = read_truth(path)
    assert recording.complete
    assert recording.run["scene"]["camera"]["lens"]["fx_px"] == 530.7
    log_ns = recording.log_ns()
    first, last = recording.truths[0].truth, recording.truths[-1].truth
    assert len(log_ns) / ((last.time_ns - first.time_ns) / 1e9) > 50.0  # of the time that did not stand still
    recorded = {record.frame_id: record.log_ns for record in recording.truths if record.frame_id is not None}
    assert captured.items() <= recorded.items()
    assert recording.stacked("q")[-1, 0] > recording.stacked("q")[0, 0] + 0.01
    assert abs(recording.stacked("valves")).max() == pytest.approx(0.4, abs=1e-4)
    assert abs(recording.stacked("valves")[-1]).max() == 0.0
    assert "status" in {fields_of(record.data)["event"] for _, record in messages(path, (EVENT,))}


def child(pid: int, module: str) -> int:
    """Process number of the child of ``pid`` that runs ``module``."""
    limit = time.monotonic() + READY_S
    while time.monotonic() < limit:  # a process that has just begun does not show its command line yet
        for child in children(pid):
            if module in Path(f"/proc/{child}/cmdline").read_text().split("\0"):
                return child
        time.sleep(0.02)
    raise AssertionError(f"no {module} among the children of {pid}")


@pytest.mark.slow("a plant starts as processes")
def test_a_killed_plant_takes_its_children_along() -> None:
    with running() as (process, ready):
        both = children(process.pid)
        assert len(both) == 2
        face = f"http://127.0.0.1:{ready['fault_face']['port']}/faults"
        assert httpx.get(face, timeout=READY_S).status_code == 200  # it looks for its plant once it serves
        os.kill(process.pid, signal.SIGKILL)
        assert all(gone(pid, 30.0) for pid in both)


@pytest.mark.slow("a plant starts as processes")
def test_a_renderer_that_ends_by_itself_ends_the_plant() -> None:
    with running() as (process, _):
        os.kill(child(process.pid, "plant_emulator.shell.camera_sender"), signal.SIGKILL)
        assert process.wait(30.0) == 1
        assert process.stderr is not None
        assert "link.renderer_ended" in process.stderr.read()


@pytest.mark.slow("a plant starts as processes")
def test_a_plant_goes_on_without_its_fault_api() -> None:
    with running() as (process, ready):
        os.kill(child(process.pid, "plant_emulator.shell.fault_api"), signal.SIGKILL)
        assert process.stderr is not None
        assert any("link.fault_api_ended" in line for line in iter(process.stderr.readline, ""))
        with socket.create_connection(("127.0.0.1", ready["modbus"]["port"]), timeout=5.0) as bus:
            bus.sendall(bytes.fromhex("000100000006010300000001"))
            assert len(bus.recv(64)) == 11
        process.terminate()
        assert process.wait(5.0) == 0


def test_a_renderer_that_breaks_says_so_in_the_schema_of_the_log() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs, socket.create_server(("127.0.0.1", 0)) as listener:
        inherited = (listener.fileno(), theirs.fileno())
        done = subprocess.run(
            [sys.executable, "-m", "plant_emulator.shell.camera_sender", *map(str, inherited), "normal"],
            input="no scene at all", capture_output=True, text=True, timeout=READY_S, pass_fds=inherited,
        )  # fmt: skip
    assert done.returncode == 1
    (line,) = map(json.loads, done.stderr.splitlines())
    assert_obeys(line, "renderer")
    assert line["event"] == "broken"


@pytest.mark.parametrize(
    ("setting", "cause", "named"),
    [
        ("scene.camera.lens.cx_px=2000", "configuration.value_error", "principal point"),
        ("scene.camera.lens.k1=-0.5", "configuration.value_error", "folds over"),
    ],
)
def test_bad_configuration_is_one_line(
    setting: str, cause: str, named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--config-dir", str(CONFIGS), "--set", setting]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert cause in line
    assert named in line
