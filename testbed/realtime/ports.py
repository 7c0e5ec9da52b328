"""The ports that services listen on: whether they are free, and who holds them where they are not."""

import contextlib
import socket
from collections.abc import Iterable
from typing import NamedTuple

import psutil

from protocol.errors import ConfigurationError


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
