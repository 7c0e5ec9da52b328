"""What is started, and where: the services, their ports, which must be free, and their options."""

import contextlib
import socket
import tempfile
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from foundation import clock
from foundation.configuration import merged, validated
from foundation.live import LiveSettings
from foundation.live.wire import FEEDS_VARIABLE
from foundation.recording.beginning import SESSION_VARIABLE
from foundation.secret_source import bound_tcp, bound_udp, read_secret
from protocol.errors import ConfigurationError
from testbed.choices import USUAL_TIMING, ClockKind, ControllerKind, Timing
from testbed.realtime.child import Service
from testbed.scenarios.scenario import Overrides, Settings, flattened, load_settings
from vision_pc.shell.machine_clock import GOES


class PortUse(NamedTuple):
    """A port that a service listens on, with the configuration key that sets it."""

    name: str
    host: str
    port: int
    kind: socket.SocketKind
    key: str

    def hindrance(self) -> str:
        """Why the port cannot be served; empty where it can."""
        bind = bound_tcp if self.kind == socket.SOCK_STREAM else bound_udp
        try:
            bind(self.host, self.port, self.key).close()
        except ConfigurationError as error:
            return f"{self.name} port {error}{holder(self.port, self.kind)}"
        return ""


def check_ports(uses: Iterable[PortUse]) -> None:
    """Return when every port is free. Raises ConfigurationError that names those that are not."""
    taken = "; ".join(filter(None, (use.hindrance() for use in uses)))
    if taken:
        advice = ". End what holds it, or use --free-ports" if "in use" in taken else ""
        raise ConfigurationError("configuration.port_in_use", taken + advice)


def holder(port: int, kind: socket.SocketKind) -> str:
    """Words on the process of this machine that holds a port; empty where it may not be seen."""
    for use in psutil.net_connections("tcp" if kind == socket.SOCK_STREAM else "udp"):
        if use.pid and use.laddr and use.laddr.port == port and not use.raddr:
            with contextlib.suppress(psutil.Error):  # it has ended, or is somebody else's
                command = " ".join(" ".join(psutil.Process(use.pid).cmdline()).split())
                return f", held by process {use.pid} ({command[:80]})"
    return ""


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port of 127.0.0.1 that was free a moment ago."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


_TCP = socket.SOCK_STREAM
CLOCK_PORT = 47200
PLANT, CONTROLLER, VISION, LIVE = "plant_emulator", "controller", "vision_pc", "live"


class Launch(NamedTuple):
    """What is to be started, in order, and where its results will be.

    ``directory`` gets the services' logs and records. ``foxglove``: the port of the live face
    that they share; none: there is none. ``clock``: whose time all go by.
    """

    services: tuple[Service, ...]
    settings: Settings
    rest_url: str
    directory: Path
    foxglove: int | None = None
    clock: ClockKind = ClockKind.WALL

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
    """Overrides by which the console may ask the emulator's face, where that does or shows anything."""
    face, api = settings.plant_service.fault_face, settings.vision.api
    if not (face.allowed or face.shows_truth):
        return {}
    own = [f"http://{host}:{api.port}" for host in dict.fromkeys((api.host, "127.0.0.1", "localhost"))]
    return {
        "plant_service": {"fault_face": {"allowed_origins": [*face.allowed_origins, *own]}},
        "vision": {"api": {"emulator_face": f"http://{face.host}:{face.port}"}},
    }


def ports_in_use(settings: Settings) -> tuple[PortUse, ...]:
    """Every port that the services will listen on."""
    service, link = settings.plant_service, settings.controller.reference_link
    udp, api = socket.SOCK_DGRAM, settings.vision.api
    listeners: tuple[tuple[str, Any, socket.SocketKind, str], ...] = (
        ("fieldbus", service.modbus, _TCP, "plant_service.modbus.port"),
        ("camera", service.camera_stream, _TCP, "plant_service.camera_stream.port"),
        ("faults", service.fault_face, _TCP, "plant_service.fault_face.port"),
        ("reference", link, udp, "controller.reference_link.port"),
        ("rest", api, _TCP, "vision.api.port"),
    )
    return tuple(PortUse(name, at.host, at.port, kind, key) for name, at, kind, key in listeners)


def clock_for(settings: Settings) -> ClockKind:
    """The plant's clock, but the wall's where a camera or the odometry is somebody else's."""
    vision = settings.vision
    ours = vision.camera.source == "stream" and vision.odometry_feed.source == "own"
    return ClockKind.PLANT if ours else ClockKind.WALL


def _clock_environment(kind: ClockKind, port: int, timing: Timing) -> dict[str, str]:
    if kind is ClockKind.WALL:
        return {clock.CLOCK: ""}
    pace = f"{timing.pace:g}" if timing.pace else "max"
    return {clock.CLOCK: f"127.0.0.1:{port}", clock.PACE: pace, GOES: timing.goes}


def _live_keys(overrides: Overrides, foxglove: int | None) -> dict[str, Any]:
    """What ``overrides`` say of the live view. Raises ConfigurationError, also where there is to be none."""
    live = dict(overrides.get("live", {}))
    if live and foxglove is None:
        raise ConfigurationError("configuration.contradiction", "live.…: nothing is shown without --foxglove")
    validated(LiveSettings, live, "live")
    return live


def prepare(
    config_dir: Path,
    overrides: Overrides,
    directory: Path,
    *,
    any_ports: bool,
    foxglove: int | None = None,
    controller: ControllerKind = ControllerKind.PYTHON,
    timing: Timing = USUAL_TIMING,
) -> Launch:
    """The launch of all three services with ``overrides``, checked before anything is started.

    Raises ConfigurationError, also when a port is taken.
    """
    live = _live_keys(overrides, foxglove)
    of_services = {name: given for name, given in overrides.items() if name != "live"}
    overrides = merged(of_services, free_ports() if any_ports else {})
    overrides = merged(overrides, _face_overrides(load_settings(config_dir, overrides)))
    settings = load_settings(config_dir, overrides)
    if foxglove == 0:
        foxglove = free_port()
    kind = timing.clock or clock_for(settings)
    ticks = free_port() if any_ports else CLOCK_PORT
    beside = {"--foxglove": foxglove, "--clock": ticks if kind is ClockKind.PLANT else None}
    shared = (PortUse(key[2:], "127.0.0.1", port, _TCP, key) for key, port in beside.items() if port)
    check_ports((*ports_in_use(settings), *shared))
    session, api = str(uuid.uuid4()), settings.vision.api
    feeds = f"{tempfile.gettempdir()}/longreach-live-{session}"
    environment = {SESSION_VARIABLE: session} | _clock_environment(kind, ticks, timing)
    environment |= {} if foxglove is None else {FEEDS_VARIABLE: feeds}
    given = [word for setting in flattened(overrides) for word in ("--set", setting)]
    common = ("--config-dir", str(config_dir), *given)
    modules = {PLANT: PLANT, CONTROLLER: controller.module, VISION: VISION}
    services = tuple(
        Service(name, module, (*common, "--record-dir", str(directory / name)), tuple(environment.items()))
        for name, module in modules.items()
    )
    if foxglove is not None:
        shown = flattened({"live": {**live, "port": foxglove}})
        services += (Service(LIVE, "foundation.live", tuple(shown), ((FEEDS_VARIABLE, feeds),)),)
    return Launch(services, settings, f"http://{api.host}:{api.port}", directory, foxglove, kind)
