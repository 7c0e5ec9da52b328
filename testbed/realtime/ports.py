"""The ports that services listen on: whether they are free, and who holds them where they are not."""

import re
import socket
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

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
    transport = "tcp" if kind == socket.SOCK_STREAM else "udp"
    inodes = {
        fields[9]
        for table in (Path(f"/proc/net/{transport}"), Path(f"/proc/net/{transport}6"))
        if table.is_file()
        for fields in map(str.split, table.read_text().splitlines()[1:])
        if int(fields[1].rpartition(":")[2], 16) == port
        and fields[3] in ("0A", "07")  # listening, unconnected
    }
    for handle in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            found = re.fullmatch(r"socket:\[(\d+)\]", str(handle.readlink()))
            if found and found.group(1) in inodes:
                pid = handle.parts[2]
                command = (Path("/proc") / pid / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
                return f", held by process {pid} ({command[:80]})"
        except OSError:
            continue  # it has ended, or is somebody else's
    return ""
