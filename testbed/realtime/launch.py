"""What is started, and where: the services, their ports, which must be free, and their options."""

import contextlib
import socket
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from foundation.configuration import merged
from foundation.secret_source import read_secret
from protocol.errors import ConfigurationError
from testbed.choices import ControllerKind
from testbed.realtime.child import Service
from testbed.scenarios.scenario import Overrides, Settings, flattened, load_settings


class PortUse(NamedTuple):
    """A port that a service listens on, with the configuration key that sets it."""

    name: str
    host: str
    port: int
    kind: socket.SocketKind
    key: str

    @property
    def label(self) -> str:
        """Host, port and transport."""
        return f"{self.host}:{self.port}/{'tcp' if self.kind == socket.SOCK_STREAM else 'udp'}"

    def hindrance(self) -> str:
        """Why the port cannot be served; empty where it can."""
        with socket.socket(socket.AF_INET, self.kind) as probe:
            if self.kind == socket.SOCK_STREAM:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((self.host, self.port))
            except OSError as error:
                return f"{error.strerror}{holder(self.port, self.kind)}"
        return ""


def check_ports(uses: Iterable[PortUse]) -> None:
    """Return when every port is free. Raises ConfigurationError that names those that are not."""
    taken = [(use, why) for use in uses if (why := use.hindrance())]
    if taken:
        told = "; ".join(f"{use.name} port {use.label} ({use.key}): {why}" for use, why in taken)
        raise ConfigurationError(
            "configuration.port_in_use", f"{told}. End what holds it, or use --free-ports"
        )


def holder(port: int, kind: socket.SocketKind) -> str:
    """Words on the process of this machine that holds a port; empty where it may not be seen."""
    for use in psutil.net_connections("tcp" if kind == socket.SOCK_STREAM else "udp"):
        if use.pid and use.laddr and use.laddr.port == port and not use.raddr:
            with contextlib.suppress(psutil.Error):  # it has ended, or is somebody else's
                command = " ".join(psutil.Process(use.pid).cmdline())
                return f", held by process {use.pid} ({command[:80]})"
    return ""


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port of 127.0.0.1 that was free a moment ago."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


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


def _face_overrides(settings: Settings) -> dict[str, Any]:
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
    controller: ControllerKind = ControllerKind.PYTHON,
) -> Launch:
    """The launch of all three services with ``overrides``, checked before anything is started.

    Raises ConfigurationError, also when a port is taken.
    """
    if any_ports:
        overrides = merged(overrides, free_ports())
    settings = load_settings(config_dir, overrides)
    if settings.plant_service.fault_face.allowed or settings.plant_service.fault_face.shows_truth:
        overrides = merged(overrides, _face_overrides(settings))
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
        module = controller.module if name == CONTROLLER else name
        return Service(name, module, options, session, feeds)

    services = tuple(map(service, (PLANT, CONTROLLER, VISION)))
    if foxglove is not None:
        shown_to = ("shared", feeds, str(foxglove), *settings.vision.live.allowed_origins)
        services += (Service(LIVE, "foundation.live", shown_to, session),)
    return launch._replace(services=services)
