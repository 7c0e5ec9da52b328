"""Whom our HTTP APIs serve: our own pages and programs, never pages of another origin; by which token."""

import base64
import binascii
import hmac
import ipaddress
import re
from collections.abc import Iterable, Mapping
from enum import StrEnum
from http import HTTPStatus
from types import MappingProxyType
from typing import NamedTuple

from foundation.rest.problems import Advise, Refusal, RefusalLog, advised, problem

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


_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+?)\.?(:[0-9]{1,5})?", re.IGNORECASE)
_OWN_SITE = frozenset({"same-origin", "none"})  # none: the person typed the address


class Guard:
    """Judges requests by their heads.

    Loopback and the address that the client reached may always be called by. A request for another name may
    come from a page whose DNS name was turned to us (DNS rebinding). Headers that only browsers send decide
    about the origin; a program that sends none is served, where tokens are wanted with one. What is refused
    is told to ``refusals``.
    """

    def __init__(self, access: Access, refusals: RefusalLog) -> None:
        self._access, self._refusals = access, refusals
        self._allowed = frozenset(host.lower() for host in access.allowed_hosts)

    def refusal(self, request: GuardedRequest) -> Refusal | None:
        """Why a request is refused, with what to do about it; None when it may go on."""
        refusal = self._refusal_of_sender(request) or (
            self._refusal_by_token(request) if self._access.tokens else None
        )
        return None if refusal is None else self.counted(refusal, request.client)

    def counted(self, refusal: Refusal, client: str) -> Refusal:
        """A refusal that is counted, and says what to do about it."""
        self._refusals.tell(refusal, client)
        return advised(refusal, self._access.advise)

    def role_of(self, request: GuardedRequest) -> Role | None:
        """Of whoever asks; None where no token is wanted, and without one of ours, or with two."""
        given = request.values(b"authorization")
        if len(given) != 1:
            return None
        presented = _presented_token(given[0])
        # Every token is compared, each in constant time: how long it takes tells nothing of them.
        tokens = self._access.tokens.items()
        matching = [role for role, token in tokens if hmac.compare_digest(token, presented)]
        return matching[0] if matching else None

    def _refusal_by_token(self, request: GuardedRequest) -> Refusal | None:
        """Why the Authorization header does not do, before the body is read."""
        if request.method in _READING and request.path in self._access.public:
            return None
        if not request.values(b"authorization"):
            why = "this service wants a token: Authorization: Bearer TOKEN"
            return request.refused(HTTPStatus.UNAUTHORIZED, "refused.no_token", why)
        role = self.role_of(request)
        if role is None:
            why = "the token is none of this service's"
            return request.refused(HTTPStatus.UNAUTHORIZED, "refused.wrong_token", why)
        if role is Role.LOOK and request.method not in _READING and request.path not in self._access.stops:
            why = f"{request.method} wants the token of {Role.OPERATE}; this one is of {Role.LOOK}"
            return request.refused(HTTPStatus.FORBIDDEN, "refused.role", why)
        return None

    def _refusal_of_sender(self, request: GuardedRequest) -> Refusal | None:
        senders, others = self._access.senders, self._access.allowed_origins
        if senders is not None and request.client not in senders:
            detail = (
                f"without tokens only this machine may ask, not {request.client}: unset LONGREACH_NO_TOKEN"
            )
            return request.refused(HTTPStatus.FORBIDDEN, "refused.other_machine", detail)
        hosts = request.values(b"host")
        if len(hosts) != 1 or not self._is_ours(hosts[0], request.server):
            detail = f"this service is not {', '.join(hosts)[:80] or 'without a name'}: see allowed_hosts"
            return request.refused(HTTPStatus.MISDIRECTED_REQUEST, "refused.foreign_host", detail)
        origins = [origin.lower() for origin in request.values(b"origin")]
        own = f"{request.scheme}://{hosts[0]}".lower()
        foreign = [f"a page of {origin[:80]}" for origin in origins if origin not in (own, *others)]
        sites = request.values(b"sec-fetch-site") if others.isdisjoint(origins) else ()
        foreign += [f"a page of another origin ({s[:20]})" for s in sites if s.lower() not in _OWN_SITE]
        if foreign:
            why = f"{foreign[0]} may not ask this service"
            return request.refused(HTTPStatus.FORBIDDEN, "refused.foreign_origin", why)
        return None

    def _is_ours(self, host: str, reached: str) -> bool:
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = match[1].strip("[]").lower()
        if name == "localhost" or name in self._allowed:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or str(address) == reached
