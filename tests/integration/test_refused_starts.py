"""What cannot be started says so in one line with its cause, and ends with a status above 0."""

import socket
from collections.abc import Callable
from pathlib import Path

import pytest

import controller.__main__
import plant_emulator.__main__
import vision_pc.__main__
from testbed.realtime.launch import free_port
from tests.support.paths import CONFIGS

MAINS: dict[str, Callable[[list[str]], int]] = {
    "plant_emulator": plant_emulator.__main__.main,
    "controller": controller.__main__.main,
    "vision_pc": vision_pc.__main__.main,
}
SERVICES = tuple(MAINS)


def configured(**ports: int) -> list[str]:
    """The command line of any service with ports that nobody has, but those given."""
    free = {
        "plant_service.modbus.port": 0,
        "plant_service.camera_stream.port": 0,
        "plant_service.fault_face.port": 0,
        "controller.reference_link.port": 0,
        "vision.api.port": free_port(),
    }
    settings = [f"{key}={port}" for key, port in (free | ports).items()]
    return ["--config-dir", str(CONFIGS), "--set", *settings]


def one_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    assert len(lines) == 1, text
    return lines[0]


@pytest.mark.parametrize(
    ("service", "setting", "key"),
    [
        ("plant_emulator", "plant.colour=red", "colour"),
        ("plant_emulator", "scene.camera.width_px=-5", "camera.width_px"),
        ("controller", "controller.cycle_ms=50", "cycle_ms"),
        ("vision_pc", "vision.look.frames=0", "look.frames"),
        ("vision_pc", "vision.look.patience=1", "look.patience"),
    ],
)
def test_a_key_unknown_or_out_of_range_is_named_with_its_value(
    service: str, setting: str, key: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert MAINS[service](["--config-dir", str(CONFIGS), "--set", setting]) == 2
    said = capsys.readouterr()
    line = one_line(said.err)
    assert "configuration." in line
    assert key in line
    assert setting.split("=")[1] in line
    assert said.out == ""


@pytest.mark.parametrize("service", SERVICES)
def test_a_directory_that_cannot_be_written_is_named(
    service: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    place = str(tmp_path / "file" / "records")
    assert MAINS[service]([*configured(), "--record-dir", place]) == 2
    said = capsys.readouterr()
    cause = "configuration.record_dir_unwritable"
    assert one_line(said.err).startswith(f"{service}: {cause}: --record-dir {place}: ")
    assert said.out == ""


@pytest.mark.parametrize(
    ("service", "key", "kind"),
    [
        ("plant_emulator", "plant_service.modbus.port", socket.SOCK_STREAM),
        ("plant_emulator", "plant_service.camera_stream.port", socket.SOCK_STREAM),
        ("plant_emulator", "plant_service.fault_face.port", socket.SOCK_STREAM),
        ("controller", "controller.reference_link.port", socket.SOCK_DGRAM),
        ("vision_pc", "vision.api.port", socket.SOCK_STREAM),
    ],
)
def test_a_busy_port_is_found_before_anything_is_left_behind(
    service: str, key: str, kind: socket.SocketKind, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(socket.AF_INET, kind) as holder:
        holder.bind(("127.0.0.1", 0))
        if kind == socket.SOCK_STREAM:
            holder.listen()
        port = holder.getsockname()[1]
        words = configured(**{key: port})
        assert MAINS[service]([*words, "--record-dir", str(tmp_path / "run")]) == 2
    line = one_line(capsys.readouterr().err)
    assert "configuration.port_busy" in line
    assert str(port) in line
    assert service != "plant_emulator" or f"{key.removesuffix('.port')} = 127.0.0.1:{port}" in line
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("service", SERVICES)
def test_a_missing_configuration_directory_is_named(service: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert MAINS[service](["--config-dir", "no-such-directory"]) == 2
    assert "configuration.unreadable" in one_line(capsys.readouterr().err)
