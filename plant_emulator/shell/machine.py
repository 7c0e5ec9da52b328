"""What the emulator asks of the machine: listening sockets, real-time priority, memory in use."""

import contextlib
import errno
import os
import socket
from pathlib import Path

from plant_emulator.config.service import Endpoint
from protocol.errors import ConfigurationError

_FIFO_PRIORITY = 20
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


def bound(endpoint: Endpoint, name: str) -> socket.socket:
    """A TCP socket bound to ``endpoint``, not yet listening. Raises ConfigurationError when it cannot be."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        sock.bind((endpoint.host, endpoint.port))
    except OSError as error:
        sock.close()
        cause = "configuration.port_busy" if error.errno == errno.EADDRINUSE else "configuration.bad_address"
        raise ConfigurationError(
            cause, f"{name} = {endpoint.host}:{endpoint.port}: {error.strerror}"
        ) from error
    return sock


def scheduling(wanted: str) -> str:
    """The scheduling that this process now has: ``fifo`` where wanted and allowed, else ``normal``."""
    if wanted == "fifo_if_allowed":
        with contextlib.suppress(PermissionError):
            parameters = os.sched_param(_FIFO_PRIORITY)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, parameters)
            return "fifo"
    return "normal"


def resident_mb(pid: int) -> float:
    """Resident memory of a process in MB; 0 when it has gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_MB
    except OSError:
        return 0.0
