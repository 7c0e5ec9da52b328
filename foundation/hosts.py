"""Names of hosts, asked before anything is sent to them."""

import socket

from protocol.errors import ConfigurationError


def known_host(host: str) -> str:
    """``host``, which has an address. Raises ConfigurationError when it has none."""
    try:
        socket.getaddrinfo(host, None)
    except OSError as error:
        raise ConfigurationError("configuration.unknown_host", f"host '{host}': {error.strerror}") from error
    return host
