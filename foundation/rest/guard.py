"""Who may ask our REST APIs, and how much: checks before a request is read, headers of every answer."""

import asyncio
import ipaddress
import json
import re
from http import HTTPStatus
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from foundation.rest.problems import (
    DATA_POLICY,
    SECURITY_HEADERS,
    Advise,
    Refusal,
    RefusalLog,
    Refuse,
    advised,
    header_values,
    problem,
    respond_unread,
)
from foundation.rest.tokens import Access, TokenCheck

_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+?)\.?(:[0-9]{1,5})?", re.IGNORECASE)
_OWN_SITE = frozenset({"same-origin", "none"})  # none: the person typed the address


class AccessGuard:
    """Serves an application to our own pages and to programs, never to a page of another origin.

    Loopback and the address that the client reached may always be called by. A request for another name may
    come from a page whose DNS name was turned to us (DNS rebinding). Headers that only browsers send decide
    about the origin; a program that sends none is served, where tokens are wanted with one. Every answer
    carries SECURITY_HEADERS where the application sets no others. What is refused is told to ``refusals``.
    """

    def __init__(self, app: ASGIApp, access: Access, refusals: RefusalLog) -> None:
        self._app = app
        self._allowed = frozenset(host.lower() for host in access.allowed_hosts)
        self._origins = access.allowed_origins
        self._senders = access.senders
        self._tokens = TokenCheck(access.tokens, access.stops, access.public) if access.tokens else None
        self._refusals = refusals
        self._advise = access.advise

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                _secure(MutableHeaders(scope=message))
            await send(message)

        refusal = self.refusal(scope)
        if refusal is None and scope.get("method") == "HEAD":
            await self._app({**scope, "method": "GET"}, receive, _only_head(sent))
        elif refusal is None:
            await self._app(scope, receive, sent)
        else:
            await respond_unread(advised(refusal, self._advise))(scope, receive, sent)

    def refusal(self, scope: Scope) -> Refusal | None:
        """Why a request is refused, which is told to ``refusals``; None when it may go on."""
        refusal = self._refusal_for(scope)
        if refusal is not None:
            self._refusals.tell(refusal, str((scope.get("client") or ("unknown",))[0]))
        return refusal

    def _refusal_for(self, scope: Scope) -> Refusal | None:
        sender = str((scope.get("client") or ("unknown",))[0])
        if self._senders is not None and sender not in self._senders:
            detail = f"without tokens only this machine may ask, not {sender}: unset LONGREACH_NO_TOKEN"
            return _problem(scope, HTTPStatus.FORBIDDEN, "refused.other_machine", detail)
        if header_values(scope, b"content-length") and header_values(scope, b"transfer-encoding"):
            detail = "Content-Length and Transfer-Encoding in one request: where it ends is nowhere written"
            return _problem(scope, HTTPStatus.BAD_REQUEST, "request.ambiguous_length", detail)
        hosts = header_values(scope, b"host")
        if len(hosts) != 1 or not self._is_ours(hosts[0], scope):
            detail = f"this service is not {', '.join(hosts)[:80] or 'without a name'}: see allowed_hosts"
            return _problem(scope, HTTPStatus.MISDIRECTED_REQUEST, "refused.foreign_host", detail)
        own = f"{scope['scheme']}://{hosts[0]}".lower()
        origins = [origin.lower() for origin in header_values(scope, b"origin")]
        for origin in origins:
            if origin != own and origin not in self._origins:
                return _foreign_origin(scope, f"a page of {origin[:80]}")
        for site in header_values(scope, b"sec-fetch-site"):
            if site.lower() not in _OWN_SITE and self._origins.isdisjoint(origins):
                return _foreign_origin(scope, f"a page of another origin ({site[:20]})")
        if self._tokens is None:
            return None
        refusal = self._tokens.refusal(scope)
        if refusal is None:
            scope["longreach.role"] = self._tokens.role_of(scope)
        return refusal

    def _is_ours(self, host: str, scope: Scope) -> bool:
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
        server = scope.get("server") or ("", None)
        return address.is_loopback or str(address) == server[0]


class BodyLimit:
    """Reads the whole body before the application is asked: at most ``limit`` bytes within ``within_s``.

    ``refuse``: the problem of a request that is refused whatever its body is; asked before anything is read.
    """

    def __init__(
        self,
        app: ASGIApp,
        limit: int,
        within_s: float,
        refuse: Refuse | None = None,
        advise: Advise | None = None,
    ) -> None:
        self._app = app
        self._limit = limit
        self._within_s = within_s
        self._refuse = refuse
        self._advise = advise

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        refusal = self._refuse(scope) if self._refuse is not None else None
        body: bytes | None = None
        if refusal is None:
            try:
                async with asyncio.timeout(self._within_s):
                    body = await self._read_body(scope, receive)
            except TimeoutError:
                refusal = _too_slow(scope, self._within_s)
            except _TooLarge:
                refusal = _too_large(scope)
            else:
                refusal = _ambiguous(scope, body)
        if refusal is not None:
            await respond_unread(advised(refusal, self._advise))(scope, receive, send)
        elif body is not None:
            await self._app(scope, _after(body, receive), send)

    async def _read_body(self, scope: Scope, receive: Receive) -> bytes | None:
        """The body; None when the client left. Raises _TooLarge, of an announced length before reading."""
        announced = ", ".join(header_values(scope, b"content-length"))
        if announced.isdigit() and int(announced) > self._limit:
            raise _TooLarge
        body = bytearray()
        more = True
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return None
            body += message.get("body", b"")
            if len(body) > self._limit:
                raise _TooLarge
            more = message.get("more_body", False)
        return bytes(body)


class _TooLarge(Exception):
    pass


class _TwiceWritten(Exception):
    pass


def _ambiguous(scope: Scope, body: bytes | None) -> Refusal | None:
    """The problem of JSON that writes a member twice: which of the two counts is nowhere written."""
    if not body:
        return None
    try:
        json.loads(body, object_pairs_hook=_unique)
    except _TwiceWritten as error:
        why = f"member {str(error)[:80]!r} is written twice in one object"
        return _problem(scope, HTTPStatus.BAD_REQUEST, "request.duplicate_member", why)
    except (ValueError, RecursionError):
        pass  # no JSON: whoever wants some says so
    return None


def _unique(members: list[tuple[str, Any]]) -> None:
    seen = set()
    for name, _ in members:
        if name in seen:
            raise _TwiceWritten(name)
        seen.add(name)


def _after(body: bytes, receive: Receive) -> Receive:
    """``receive`` that gives ``body`` first."""
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def received() -> Message:
        return messages.pop() if messages else await receive()

    return received


def _only_head(send: Send) -> Send:
    """``send`` that ends an answer behind its headers, as HEAD wants it of what GET would get."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            await send(message)
            await send({"type": "http.response.body", "body": b"", "more_body": False})

    return sent


def _secure(headers: MutableHeaders) -> None:
    for name, value in SECURITY_HEADERS.items():
        headers.setdefault(name, value)
    headers.setdefault("Content-Security-Policy", DATA_POLICY)


def _problem(scope: Scope, status: HTTPStatus, cause: str, detail: str) -> Refusal:
    return problem(status, cause, detail, instance=scope["path"])


def _foreign_origin(scope: Scope, who: str) -> Refusal:
    return _problem(scope, HTTPStatus.FORBIDDEN, "refused.foreign_origin", f"{who} may not ask this service")


def _too_large(scope: Scope) -> Refusal:
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    return _problem(scope, status, "request.too_large", "the request's body is too large")


def _too_slow(scope: Scope, within_s: float) -> Refusal:
    status = HTTPStatus.REQUEST_TIMEOUT
    return _problem(scope, status, "request.too_slow", f"the body did not come within {within_s:g} s")
