"""Where the tokens of a REST API are. Compulsory where others than this machine can ask."""

import ipaddress
from collections.abc import Iterable
from typing import Protocol

from foundation.configuration import StrictModel
from foundation.rest.access import Access, Role
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
