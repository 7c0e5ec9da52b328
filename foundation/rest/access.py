"""Who may look, who may operate: what a request carries, and the tokens by which it is judged."""

import base64
import binascii
import hmac
from collections.abc import Iterable, Mapping
from enum import StrEnum
from http import HTTPStatus
from types import MappingProxyType
from typing import NamedTuple

from foundation.rest.problems import Advise, Refusal, problem

_READING = frozenset({"GET", "HEAD"})


class Role(StrEnum):
    """What a token lets its holder do: LOOK reads and follows, OPERATE also moves and changes."""

    LOOK = "look"
    OPERATE = "operate"


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


class GuardedRequest(NamedTuple):
    """What is judged of a request. ``fields``: of its head, names in lower case.

    ``client``: the address that it comes from; ``server``: the one that it reached.
    """

    method: str
    path: str
    fields: Iterable[tuple[bytes, bytes]]
    client: str
    server: str
    scheme: str = "http"

    def values(self, name: bytes) -> list[str]:
        """Every value of a field, in the order of the request."""
        return [value.decode("latin-1") for key, value in self.fields if key == name]

    def refused(self, status: HTTPStatus, cause: str, why: str) -> Refusal:
        """The problem of it."""
        return problem(status, cause, why, instance=self.path)


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

    def refusal(self, asked: GuardedRequest) -> Refusal | None:
        """Why the request is refused, before its body is read; None when it may go on."""
        if asked.method in _READING and asked.path in self._public:
            return None
        if not asked.values(b"authorization"):
            why = "this service wants a token: Authorization: Bearer TOKEN"
            return asked.refused(HTTPStatus.UNAUTHORIZED, "refused.no_token", why)
        role = self.role_of(asked)
        if role is None:
            why = "the token is none of this service's"
            return asked.refused(HTTPStatus.UNAUTHORIZED, "refused.wrong_token", why)
        if role is Role.LOOK and asked.method not in _READING and asked.path not in self._open_to_look:
            why = f"{asked.method} wants the token of {Role.OPERATE}; this one is of {Role.LOOK}"
            return asked.refused(HTTPStatus.FORBIDDEN, "refused.role", why)
        return None

    def role_of(self, asked: GuardedRequest) -> Role | None:
        """Of whoever asks; None without a token, or with two."""
        given = asked.values(b"authorization")
        if len(given) != 1:
            return None
        presented = _presented_token(given[0])
        # Every token is compared, each in constant time: how long it takes tells nothing of them.
        matching = [role for role, token in self._tokens.items() if hmac.compare_digest(token, presented)]
        return matching[0] if matching else None


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
