"""The three services as the supervisor starts them: their command lines, ports and files."""

import socket
import uuid
from pathlib import Path
from typing import Any, NamedTuple

from foundation.configuration import merged
from foundation.secret_source import read_secret
from testbed.realtime.child import Service
from testbed.realtime.ports import PortUse, check_ports
from testbed.realtime.supervisor import free_port
from testbed.scenarios.scenario import flattened
from testbed.scenarios.settings import Overrides, Settings, load_settings

_TCP = socket.SOCK_STREAM
PLANT, CONTROLLER, VISION, LIVE = "plant_emulator", "controller", "vision_pc", "live"


class Launch(NamedTuple):
    """What is to be started, in order, and where its results will be.

    ``directory`` gets the services' logs, records and statistics. ``foxglove``: the port of the live face
    that they share; none: there is none.
    """

    services: tuple[Service, ...]
    settings: Settings
    rest_url: str
    directory: Path
    foxglove: int | None = None

    def statistics(self, service: str) -> Path:
        """The file in which ``service`` leaves its figures when it ends."""
        return self.directory / f"{service}.statistics.json"

    def rest_token(self) -> bytes | None:
        """The token that lets its holder operate, where vision's REST API wants one.

        Raises ConfigurationError as ``read_secret`` does.
        """
        return read_secret(self.settings.vision.api.tokens.operate, "operate token")

    def records(self, service: str) -> Path:
        """The directory into which ``service`` records."""
        return self.directory / service


def free_ports() -> dict[str, Any]:
    """Overrides that give every listener a free port and tell its peers."""
    modbus, camera, faults, rest = (free_port() for _ in range(4))
    reference = free_port(socket.SOCK_DGRAM)
    return {
        "plant_service": {
            "modbus": {"port": modbus},
            "camera_stream": {"port": camera},
            "fault_face": {"port": faults},
        },
        "controller": {"plant_link": {"port": modbus}, "reference_link": {"port": reference}},
        "vision": {
            "link": {"port": reference},
            "camera": {"stream": {"port": camera}},
            "api": {"port": rest},
        },
    }


def _introduced(settings: Settings) -> dict[str, Any]:
    """Overrides by which the console may ask the emulator's face, and knows where it is."""
    face, api = settings.plant_service.fault_face, settings.vision.api
    own = [f"http://{host}:{api.port}" for host in dict.fromkeys((api.host, "127.0.0.1", "localhost"))]
    return {
        "plant_service": {"fault_face": {"allowed_origins": [*face.allowed_origins, *own]}},
        "vision": {"api": {"emulator_face": f"http://{face.host}:{face.port}"}},
    }


def ports_in_use(settings: Settings) -> tuple[PortUse, ...]:
    """Every port that the services will listen on."""
    service, link, api = settings.plant_service, settings.controller.reference_link, settings.vision.api
    tcp, udp = socket.SOCK_STREAM, socket.SOCK_DGRAM
    fieldbus, camera, faults = service.modbus, service.camera_stream, service.fault_face
    return (
        PortUse("fieldbus", fieldbus.host, fieldbus.port, tcp, "plant_service.modbus.port"),
        PortUse("camera", camera.host, camera.port, tcp, "plant_service.camera_stream.port"),
        PortUse("faults", faults.host, faults.port, tcp, "plant_service.fault_face.port"),
        PortUse("reference", link.host, link.port, udp, "controller.reference_link.port"),
        PortUse("rest", api.host, api.port, tcp, "vision.api.port"),
    )


def prepare(
    config_dir: Path,
    overrides: Overrides,
    directory: Path,
    *,
    any_ports: bool,
    foxglove: int | None = None,
) -> Launch:
    """The launch of all three services with ``overrides``, checked before anything is started.

    Raises ConfigurationError, also when a port is taken.
    """
    if any_ports:
        overrides = merged(overrides, free_ports())
    settings = load_settings(config_dir, overrides)
    if settings.plant_service.fault_face.allowed or settings.plant_service.fault_face.shows_truth:
        overrides = merged(overrides, _introduced(settings))
        settings = load_settings(config_dir, overrides)
    if foxglove == 0:
        foxglove = free_port()
    shared = () if foxglove is None else (PortUse("live", "127.0.0.1", foxglove, _TCP, "--foxglove"),)
    check_ports((*ports_in_use(settings), *shared))
    api = settings.vision.api
    session = str(uuid.uuid4())
    launch = Launch((), settings, f"http://{api.host}:{api.port}", directory, foxglove)
    feeds = "" if foxglove is None else f"longreach-live-{session}"
    common = ["--config-dir", str(config_dir)]
    for setting in flattened(overrides):
        common += ["--set", setting]

    def service(name: str) -> Service:
        records = ["--record-dir", str(launch.records(name))]
        options = (*common, *records, "--statistics", str(launch.statistics(name)))
        return Service(name, name, options, session, feeds)

    services = tuple(map(service, (PLANT, CONTROLLER, VISION)))
    if foxglove is not None:
        shown_to = ("shared", feeds, str(foxglove), *settings.vision.live.allowed_origins)
        services += (Service(LIVE, "foundation.live", shown_to, session),)
    return launch._replace(services=services)
