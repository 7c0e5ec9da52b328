"""What cannot be started says so in one line with its cause, and ends with a status above 0."""

import socket

import pytest

from tests.integration.services import run_service

SERVICES = ("plant_emulator", "controller", "vision_pc")


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
def test_a_key_unknown_or_out_of_range_is_named_with_its_value(service: str, setting: str, key: str) -> None:
    ended = run_service(service, "--set", setting)
    assert ended.returncode == 2
    said = one_line(ended.stderr)
    assert "configuration." in said
    assert key in said
    assert setting.split("=")[1] in said
    assert ended.stdout == ""


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
def test_a_busy_port_is_named(service: str, key: str, kind: socket.SocketKind) -> None:
    with socket.socket(socket.AF_INET, kind) as holder:
        holder.bind(("127.0.0.1", 0))
        if kind == socket.SOCK_STREAM:
            holder.listen()
        port = holder.getsockname()[1]
        listeners = ("modbus", "camera_stream", "fault_face")
        others = [f"plant_service.{listener}.port=0" for listener in listeners]
        settings = [f"{key}={port}", *(other for other in others if not other.startswith(key))]
        ended = run_service(service, *(word for setting in settings for word in ("--set", setting)))
    assert ended.returncode == 2
    said = one_line(ended.stderr)
    assert "configuration.port_busy" in said
    assert str(port) in said


@pytest.mark.parametrize("service", SERVICES)
def test_a_missing_configuration_directory_is_named(service: str) -> None:
    ended = run_service(service, "--config-dir", "no-such-directory")
    assert ended.returncode == 2
    assert "configuration.unreadable" in one_line(ended.stderr)


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["demo", "--scenario", "nowhere"], "configuration.unknown_scenario"),
        (["demo", "--lockstep", "--set", "plant.colour=red"], "configuration.unknown_key"),
        (["up", "--set", "garden.gnome=1"], "configuration.unknown_file"),
        (["up", "--set", "plant.payload"], "configuration.bad_override"),
        (["doctor", "--json", "/proc/nothing/here.json"], "output.unwritable"),
    ],
)
def test_the_command_answers_mistakes_in_one_line(arguments: list[str], cause: str) -> None:
    ended = run_service("testbed.cli", *arguments)
    assert ended.returncode == 2
    assert f"longreach: {cause}: " in one_line(ended.stderr)
