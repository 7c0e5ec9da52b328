"""Tokens of a REST API: who may look, who may operate. Compulsory where others than this machine can ask."""

import base64
import binascii
import hmac
import ipaddress
from collections.abc import Iterable, Mapping
from enum import StrEnum
from http import HTTPStatus
from types import MappingProxyType
from typing import NamedTuple, Protocol

from starlette.types import Scope

from foundation.configuration import StrictModel
from foundation.rest.problems import Advise, Refusal, header_values, problem
from foundation.secret_source import SecretSource, read_secret
from protocol.errors import ConfigurationError

_READING = frozenset({"GET", "HEAD"})


class Role(StrEnum):
    """What a token lets its holder do: LOOK reads and follows, OPERATE also moves and changes."""

    LOOK = "look"
    OPERATE = "operate"


class TokenSources(StrictModel):
    """Where the token of each role is; where none is named, nobody is asked for one."""

    look: SecretSource = SecretSource()
    operate: SecretSource = SecretSource()


class TokenCheck:
    """Decides by the Authorization header.

    ``open_to_look``: paths that whoever may look may POST to. ``public``: paths that anybody may read.
    """

    def __init__(
        self, tokens: Mapping[Role, bytes], open_to_look: Iterable[str] = (), public: Iterable[str] = ()
    ) -> None:
        self._tokens = dict(tokens)
        self._public = frozenset(public)
        self._open_to_look = frozenset(open_to_look)

    def refusal(self, scope: Scope) -> Refusal | None:
        """Why the request is refused, before its body is read; None when it may go on."""
        if scope["method"] in _READING and scope["path"] in self._public:
            return None
        given = header_values(scope, b"authorization")
        if not given:
            why = "this service wants a token: Authorization: Bearer TOKEN"
            return _refusal(scope, HTTPStatus.UNAUTHORIZED, "refused.no_token", why)
        role = self._role_of(given[0]) if len(given) == 1 else None
        if role is None:
            why = "the token is none of this service's"
            return _refusal(scope, HTTPStatus.UNAUTHORIZED, "refused.wrong_token", why)
        if role is Role.LOOK and scope["method"] not in _READING and scope["path"] not in self._open_to_look:
            why = f"{scope['method']} wants the token of {Role.OPERATE}; this one is of {Role.LOOK}"
            return _refusal(scope, HTTPStatus.FORBIDDEN, "refused.role", why)
        return None

    def role_of(self, scope: Scope) -> Role | None:
        """Of whoever asks; None without a token."""
        given = header_values(scope, b"authorization")
        return self._role_of(given[0]) if len(given) == 1 else None

    def _role_of(self, authorization: str) -> Role | None:
        presented = _presented_token(authorization)
        # Every token is compared, each in constant time: how long it takes tells nothing of them.
        matching = [role for role, token in self._tokens.items() if hmac.compare_digest(token, presented)]
        return matching[0] if matching else None


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


def _presented_token(authorization: str) -> bytes:
    """The token of a Bearer header, or the password of a Basic one, as browsers send; empty: none."""
    scheme, _, credentials = authorization.partition(" ")
    try:
        if scheme.lower() == "basic":
            user_and_token = base64.b64decode(credentials.strip(), validate=True)
            return bytes.fromhex(user_and_token.partition(b":")[2].decode("ascii"))
        return bytes.fromhex(credentials) if scheme.lower() == "bearer" else b""
    except (ValueError, binascii.Error):
        return b""


def _refusal(scope: Scope, status: HTTPStatus, cause: str, why: str) -> Refusal:
    return problem(status, cause, why, instance=scope["path"])


class Access(NamedTuple):
    """``allowed_hosts``: names, without port, beside loopback and the address that was reached.

    ``tokens``: by role; none: nobody is asked for one. ``stops``: paths that whoever may look may POST to.
    ``public``: paths that may be read without a token: a page that asks for one, and nothing else.
    ``allowed_origins``: pages of others that may ask, in lower case. ``advise``: what to do about a refusal.
    ``senders``: addresses that requests may come from; None: any.
    """

    allowed_hosts: tuple[str, ...] = ()
    tokens: Mapping[Role, bytes] = MappingProxyType({})
    stops: frozenset[str] = frozenset()
    public: frozenset[str] = frozenset()
    allowed_origins: frozenset[str] = frozenset()
    advise: Advise | None = None
    senders: frozenset[str] | None = None


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
