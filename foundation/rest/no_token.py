"""A REST API without tokens for somebody who is alone on a machine: one variable of the environment says so.

What listens at an address beyond loopback needs tokens. In a container it has to listen so, and the engine
publishes its port on the host's loopback: requests then come from the container's gateway. There, and there
alone, the variable does without tokens; every other sender is refused.
"""

import socket
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path

from foundation.rest.access import Access
from foundation.rest.tokens import RestSettings, configured_access, is_loopback
from protocol.errors import ConfigurationError

NO_TOKEN = "LONGREACH_NO_TOKEN"
WARNING = f"{NO_TOKEN}=1: no token is asked for; every program and user of this machine may move the arm"
_MARKS = (Path("/.dockerenv"), Path("/run/.containerenv"))
_ROUTES = Path("/proc/net/route")


def without_token(environment: Mapping[str, str]) -> bool:
    """Whether the variable is set. Raises ConfigurationError (``configuration.no_token``) for all but 1."""
    said = environment.get(NO_TOKEN, "")
    if said not in ("", "1"):
        why = f"{NO_TOKEN} = {said[:40]!r}; wanted 1, or nothing, which asks for tokens"
        raise ConfigurationError("configuration.no_token", why)
    return said == "1"


def access_without_token(
    settings: RestSettings,
    setting: str,
    environment: Mapping[str, str],
    stops: Iterable[str] = (),
    public: Iterable[str] = (),
) -> Access:
    """Whom ``settings``, found at ``setting``, let ask: with ``LONGREACH_NO_TOKEN=1`` this machine alone.

    Raises ConfigurationError as ``configured_access`` and ``without_token`` do, and for the variable with a
    host beyond loopback outside a container (``configuration.no_token``).
    """
    if not without_token(environment):
        return configured_access(settings, setting, stops, public)
    senders: frozenset[str] | None = None
    if not is_loopback(settings.host):
        if not any(mark.exists() for mark in _MARKS):
            why = f"{NO_TOKEN}=1 holds on loopback alone; {setting}.host is {settings.host}: name tokens"
            raise ConfigurationError("configuration.no_token", why)
        senders = frozenset(("127.0.0.1", "::1", *gateways(_ROUTES.read_text(encoding="ascii"))))
    return Access((settings.host, *settings.allowed_hosts), senders=senders)


def gateways(routes: str) -> list[str]:
    """The addresses of the default gateways. ``routes``: the text of /proc/net/route."""
    rows = [line.split() for line in routes.splitlines()[1:]]
    return [
        _address(row[2]) for row in rows if len(row) > 2 and row[1] == "00000000" and row[2] != "00000000"
    ]


def _address(little_endian_hex: str) -> str:
    return socket.inet_ntoa(struct.pack("<I", int(little_endian_hex, 16)))
