"""What every REST API of ours has: problem documents, a door, and uvicorn behind it."""

import contextlib
import json
import socket
import tempfile
from collections import Counter
from collections.abc import AsyncIterator, Callable, Generator, Iterator, Mapping
from http import HTTPStatus
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from foundation.configuration import fault_reason, fault_words
from foundation.event_log import EventLog
from foundation.rest.door import Door
from foundation.rest.guard import Access, Guard
from foundation.rest.problems import MEDIA_TYPE, Advise, Refusal, RefusalLog, advised, problem, problem_of
from protocol.errors import LongreachError

_DRAIN_S = 1  # for answers under way at the end; a service must be gone within 2 s
_FAULTS_SHOWN = 20
Explain = Callable[[RequestValidationError], dict[str, Any]]


def respond(document: Refusal) -> JSONResponse:
    """The response that carries a problem document."""
    return JSONResponse(document, status_code=document["status"], media_type=MEDIA_TYPE)


class RestServer(uvicorn.Server):
    """Uvicorn behind a door, in whatever loop serves: signals and log are the service's.

    ``serve`` takes the listener of ``service_socket``.
    """

    def __init__(self, app: FastAPI) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http="h11",
                ws="none",
                server_header=False,
                log_config=None,
                access_log=False,
                lifespan="off",
                timeout_graceful_shutdown=_DRAIN_S,
            )
        )

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Leave the signals alone."""
        yield


@contextlib.contextmanager
def service_socket() -> Iterator[tuple[str, socket.socket]]:
    """Where a service listens for its door alone, in a directory of this user: path, listener."""
    with (
        tempfile.TemporaryDirectory(prefix="longreach-") as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener,
    ):
        listener.bind(f"{folder}/rest")
        listener.listen()
        yield f"{folder}/rest", listener


@contextlib.asynccontextmanager
async def door(listener: socket.socket, at: str, access: Access, log: EventLog | None) -> AsyncIterator[Door]:
    """A door at ``listener`` in this very loop, for as long as the block lasts, to the service at ``at``."""
    made = Door(at, Guard(access, RefusalLog(log)), access.stops)
    serving = await made.serve(listener)
    try:
        yield made
    finally:
        serving.close()
        made.close()


def invalid_request(error: RequestValidationError) -> dict[str, Any]:
    """The problem of a request that does not fit its schema, with the first faults as ``faults``."""
    faults = [{"at": list(each["loc"]), "why": fault_reason(each)} for each in error.errors()[:_FAULTS_SHOWN]]
    detail = fault_words(error.errors()[0])
    return problem(HTTPStatus.UNPROCESSABLE_ENTITY, "request.invalid", detail, faults=faults)


def install_problems(
    app: FastAPI,
    status_of_cause: Mapping[str, HTTPStatus],
    explain: Explain = invalid_request,
    advise: Advise | None = None,
) -> None:
    """Make every error of ``app`` a problem document.

    ``explain``: the problem of a request that does not fit its schema. ``advise``: what to do about a cause;
    documents have it as ``advice``.
    """
    app.add_middleware(OnceWritten, advise=advise)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        return respond(advised(explain(error) | {"instance": request.url.path}, advise))

    @app.exception_handler(HTTPException)
    async def http_error(request: Request, error: HTTPException) -> JSONResponse:
        cause = "request." + HTTPStatus(error.status_code).name.lower()
        detail = _http_words(request, error)
        document = problem(error.status_code, cause, detail, instance=request.url.path)
        response = respond(advised(document, advise))
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(LongreachError)
    @app.exception_handler(Exception)
    async def failed(request: Request, error: Exception) -> JSONResponse:
        document = problem_of(error, status_of_cause) | {"instance": request.url.path}
        return respond(advised(document, advise))


def _http_words(request: Request, error: HTTPException) -> str:
    asked, routes = f"{request.method} {request.url.path}", request.app.routes
    there = (route.methods for route in routes if route.matches(request.scope)[0] is Match.PARTIAL)
    words = {
        HTTPStatus.NOT_FOUND: f"{asked}: nothing is at this path; /docs has all",
        HTTPStatus.METHOD_NOT_ALLOWED: f"{asked}: wanted is {' or '.join(sorted(set().union(*there)))}",
    }
    if isinstance(error.__cause__, ValueError):
        return "the body is no JSON: wanted are UTF-8, no Content-Encoding, numbers of at most 4300 digits"
    return words.get(HTTPStatus(error.status_code), str(error.detail))


class OnceWritten:
    """Refuses JSON that writes a member twice: which of the two counts is nowhere written. Passes over a
    slash behind a path.
    """

    def __init__(self, app: ASGIApp, advise: Advise | None) -> None:
        self._app = app
        self._advise = advise

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request, whose body has come whole."""
        messages: list[Message] = [await receive()]
        while messages[-1].get("more_body", False):
            messages.append(await receive())
        refusal = _ambiguity(b"".join(message.get("body", b"") for message in messages))
        if refusal is not None:
            document = problem(HTTPStatus.BAD_REQUEST, *refusal, instance=scope["path"])
            await respond(advised(document, self._advise))(scope, receive, send)
            return

        async def received() -> Message:
            return messages.pop(0) if messages else await receive()

        await self._app(dict(scope) | {"path": scope["path"].rstrip("/") or "/"}, received, send)


def _ambiguity(body: bytes) -> tuple[str, str] | None:
    """Cause and detail of JSON that is not to be read; what is no JSON, whoever wants some says so."""
    twice: list[str] = []

    def unique(members: list[tuple[str, Any]]) -> None:
        if len({name for name, _ in members}) < len(members):
            twice.extend(name for name, count in Counter(name for name, _ in members).items() if count > 1)

    try:
        json.loads(body or b"0", object_pairs_hook=unique)
    except RecursionError:
        return "request.too_deep", "the body is nested too deeply"
    except ValueError:
        return None
    why = "member {!r} is written twice in one object"
    return ("request.duplicate_member", why.format(twice[0][:80])) if twice else None
