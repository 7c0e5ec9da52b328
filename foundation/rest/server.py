"""What every REST API of ours has: problem documents, limits, a guarded server in the service's loop."""

import asyncio
import contextlib
from collections.abc import Callable, Generator, Mapping
from http import HTTPStatus
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from uvicorn.protocols.http.h11_impl import H11Protocol

from foundation.event_log import EventLog
from foundation.problems import problem, problem_of
from foundation.rest.access import ANYBODY_HERE, Access
from foundation.rest.guard import AccessGuard, BodyLimit
from foundation.rest.refusals import Refuse, respond
from protocol.errors import LongreachError

MAX_BODY_BYTES = 16_384
BODY_WITHIN_S = 5.0
HEADERS_WITHIN_S = 10.0  # beyond the 5 s for which uvicorn keeps an idle connection
_DRAIN_S = 1  # for answers under way at the end; a service must be gone within 2 s
_FAULTS_SHOWN = 20
Explain = Callable[[RequestValidationError], dict[str, Any]]


class _ImpatientProtocol(H11Protocol):
    """HTTP/1.1 that ends a connection whose next request does not arrive whole, but for its body, in time."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The first request is due. Where no place is free, the oldest that is not being served yields."""
        super().connection_made(transport)
        self._came_s = self.loop.time()
        self._await_request()
        if self.limit_concurrency is not None and len(self.connections) >= self.limit_concurrency:
            idle = [other for other in self.connections if isinstance(other, _ImpatientProtocol)]
            idle = [other for other in idle if other is not self and not other.is_served]
            if idle:
                min(idle, key=lambda other: other._came_s).transport.abort()

    @property
    def is_served(self) -> bool:
        """Whether a request has come whole and is being answered."""
        return self.cycle is not None and not (self.cycle.response_complete or self.cycle.more_body)

    def data_received(self, data: bytes) -> None:
        """A piece of a request; pieces do not put the deadline off."""
        super().data_received(data)
        self._await_request()

    def on_response_complete(self) -> None:
        """The next request is due; one that has come already is served at once."""
        super().on_response_complete()
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is due any more."""
        super().connection_lost(exc)
        self._forget_deadline()

    def _await_request(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self._forget_deadline()
        elif self._deadline is None and not self.transport.is_closing():
            self._deadline = self.loop.call_later(HEADERS_WITHIN_S, self.transport.close)

    def _forget_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class RestServer(uvicorn.Server):
    """Uvicorn in the service's own loop: signals and log are the service's. ``serve`` takes bound sockets.

    ``access``: whom it serves. ``refused`` counts, by cause, whom it did not; each is told to ``log``.
    ``places``: how many connections it keeps; the oldest that is not being served then yields to a new one,
    which is answered 503 where all of them are.
    """

    def __init__(
        self,
        app: FastAPI,
        access: Access = ANYBODY_HERE,
        log: EventLog | None = None,
        places: int | None = None,
    ) -> None:
        guard = AccessGuard(app, access, log)
        self.refused = guard.refused
        super().__init__(
            uvicorn.Config(
                guard,
                http=_ImpatientProtocol,
                ws="none",
                server_header=False,
                log_config=None,
                access_log=False,
                lifespan="off",
                limit_concurrency=None if places is None else places + 1,
                timeout_graceful_shutdown=_DRAIN_S,
            )
        )

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Leave the signals alone."""
        yield


def invalid_request(error: RequestValidationError) -> dict[str, Any]:
    """The problem of a request that does not fit its schema, with the first faults as ``faults``."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    faults = [{"at": list(each["loc"]), "why": each["msg"]} for each in error.errors()[:_FAULTS_SHOWN]]
    detail = f"{where}: {first['msg']}"
    return problem(HTTPStatus.UNPROCESSABLE_ENTITY, "request.invalid", detail, faults=faults)


def install_problems(
    app: FastAPI,
    status_of_cause: Mapping[str, HTTPStatus],
    explain: Explain = invalid_request,
    refuse: Refuse | None = None,
) -> None:
    """Make every error of ``app`` a problem document, and limit request bodies in size and time.

    ``explain``: the problem of a request that does not fit its schema. ``refuse``: see BodyLimit.
    """
    app.add_middleware(BodyLimit, limit=MAX_BODY_BYTES, within_s=BODY_WITHIN_S, refuse=refuse)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        return respond(explain(error) | {"instance": request.url.path})

    @app.exception_handler(HTTPException)
    async def http_error(request: Request, error: HTTPException) -> JSONResponse:
        cause = "request." + HTTPStatus(error.status_code).name.lower()
        document = problem(error.status_code, cause, str(error.detail), instance=request.url.path)
        response = respond(document)
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(LongreachError)
    @app.exception_handler(Exception)
    async def failed(request: Request, error: Exception) -> JSONResponse:
        return respond(problem_of(error, status_of_cause) | {"instance": request.url.path})
