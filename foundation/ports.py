"""Configured addresses, tried before anything starts or is sent: one line when that cannot be."""

import errno
import socket

from protocol.errors import ConfigurationError


def bound_tcp(host: str, port: int, key: str) -> socket.socket:
    """A TCP socket bound to an address, not yet listening; ``key`` names the setting.

    Raises ConfigurationError when the port is busy, or the address is not ours.
    """
    return _bound(socket.SOCK_STREAM, host, port, key)


def bound_udp(host: str, port: int, key: str) -> socket.socket:
    """A UDP socket that does not block, bound to an address. Raises ConfigurationError as ``bound_tcp``."""
    sock = _bound(socket.SOCK_DGRAM, host, port, key)
    sock.setblocking(False)
    return sock


def _bound(kind: socket.SocketKind, host: str, port: int, key: str) -> socket.socket:
    sock = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:  # what is left of closed connections holds a port for a minute
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        cause = "configuration.port_busy" if error.errno == errno.EADDRINUSE else "configuration.bad_address"
        raise ConfigurationError(cause, f"{key} = {host}:{port}: {error.strerror}") from error
    return sock


def known_host(host: str) -> str:
    """``host``, which has an address. Raises ConfigurationError when it has none."""
    try:
        socket.getaddrinfo(host, None)
    except OSError as error:
        raise ConfigurationError("configuration.unknown_host", f"host '{host}': {error.strerror}") from error
    return host
