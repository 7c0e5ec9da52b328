"""Where the tokens of a REST API are. Compulsory where others than this machine can ask.

Somebody who is alone on a machine may do without: one variable of the environment says so. In a container
an API has to listen beyond loopback, and the engine publishes its port on the host's loopback: requests then
come from the container's gateway. There, and there alone, the variable does without tokens; every other
sender is refused.
"""

import ipaddress
import socket
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Protocol

from foundation.configuration import StrictModel
from foundation.rest.guard import Access, Role
from foundation.secret_source import SecretSource, read_secret
from protocol.errors import ConfigurationError


class TokenSources(StrictModel):
    """Where the token of each role is; where none is named, nobody is asked for one."""

    look: SecretSource = SecretSource()
    operate: SecretSource = SecretSource()


def read_tokens(sources: TokenSources, host: str, setting: str) -> dict[Role, bytes]:
    """The tokens that ``sources`` names, for an API that listens at ``host``; empty: nobody is asked.

    ``setting``: such as ``vision.api``. Raises ConfigurationError as ``read_secret`` does, for two equal
    tokens (``configuration.tokens_equal``), and for a host beyond loopback without a token
    (``configuration.token_wanted``).
    """
    named = {Role.LOOK: sources.look, Role.OPERATE: sources.operate}
    secrets = {role: read_secret(source, f"{setting}: {role} token") for role, source in named.items()}
    tokens = {role: secret for role, secret in secrets.items() if secret is not None}
    if not tokens and not is_loopback(host):
        why = (
            f"{setting}.host = {host} lets others than this machine ask, and no token is named; make one by "
            f"'longreach token new FILE' and name it by '--set {setting}.tokens.operate.file=FILE'"
        )
        raise ConfigurationError("configuration.token_wanted", why)
    if len(set(tokens.values())) < len(tokens):
        why = f"{setting}.tokens: look and operate are the same token"
        raise ConfigurationError("configuration.tokens_equal", why)
    return tokens


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a service at ``host``: not so for any name but localhost."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class RestSettings(Protocol):
    """What the configuration of a REST API says of this."""

    @property
    def host(self) -> str:
        """Where it listens."""

    @property
    def allowed_hosts(self) -> tuple[str, ...]:
        """Further names."""

    @property
    def tokens(self) -> TokenSources:
        """Where the tokens are."""


def configured_access(
    settings: RestSettings, setting: str, stops: Iterable[str] = (), public: Iterable[str] = ()
) -> Access:
    """What ``settings``, found at ``setting``, say. Raises ConfigurationError as ``read_tokens`` does."""
    tokens = read_tokens(settings.tokens, settings.host, setting)
    return Access((settings.host, *settings.allowed_hosts), tokens, frozenset(stops), frozenset(public))


NO_TOKEN = "LONGREACH_NO_TOKEN"
WARNING = f"{NO_TOKEN}=1: no token is asked for; every program and user of this machine may move the arm"
_MARKS = (Path("/.dockerenv"), Path("/run/.containerenv"))
_ROUTES = Path("/proc/net/route")


def without_token(environment: Mapping[str, str]) -> bool:
    """Whether the variable is set. Raises ConfigurationError (``configuration.no_token``) for all but 1."""
    value = environment.get(NO_TOKEN, "")
    if value not in ("", "1"):
        why = f"{NO_TOKEN} = {value[:40]!r}; wanted 1, or nothing, which asks for tokens"
        raise ConfigurationError("configuration.no_token", why)
    return value == "1"


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
