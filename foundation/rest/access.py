"""Whom a REST API serves: the names that it may be called by, and the tokens that it wants."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple, Protocol

from foundation.rest.tokens import Role, TokenSources, read_tokens


class Access(NamedTuple):
    """``allowed_hosts``: names, without port, beside loopback and the address that was reached.

    ``tokens``: by role; none: nobody is asked for one. ``stops``: paths that whoever may look may POST to.
    ``public``: paths that may be read without a token: a page that asks for one, and nothing else.
    ``allowed_origins``: pages of others that may ask, in lower case.
    """

    allowed_hosts: tuple[str, ...] = ()
    tokens: Mapping[Role, bytes] = MappingProxyType({})
    stops: frozenset[str] = frozenset()
    public: frozenset[str] = frozenset()
    allowed_origins: frozenset[str] = frozenset()


ANYBODY_HERE = Access()


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
