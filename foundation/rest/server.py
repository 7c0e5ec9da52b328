"""What every REST API of ours has: problem documents, limits, a guarded server."""

import asyncio
import contextlib
import functools
import resource
import socket
import sys
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from typing import Any, cast

import uvicorn
import uvloop
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from foundation.event_log import EventLog
from foundation.rest.connections import Door, Lanes
from foundation.rest.guard import AccessGuard, BodyLimit
from foundation.rest.problems import Advise, RefusalLog, Refuse, advised, problem, problem_of, respond
from foundation.rest.tokens import ANYBODY_HERE, Access
from protocol.errors import LongreachError

MAX_BODY_BYTES = 16_384
BODY_WITHIN_S = 5.0
_DRAIN_S = 1  # for answers under way at the end; a service must be gone within 2 s
_FAULTS_SHOWN = 20
_BACKLOG = 1024  # connections that wait while one turn lasts
Explain = Callable[[RequestValidationError], dict[str, Any]]


class RestServer(uvicorn.Server):
    """Uvicorn in whatever loop serves: signals and log are the service's. ``serve`` takes bound sockets.

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
        refusals = RefusalLog(log)
        access = access._replace(advise=getattr(app.state, "advise", None))
        self.refused = refusals.counts
        lanes = Lanes(access.stops, refusals)
        super().__init__(
            uvicorn.Config(
                AccessGuard(app, access, refusals),
                http=cast(Any, functools.partial(Door, lanes)),
                backlog=_BACKLOG,
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
    advise: Advise | None = None,
) -> None:
    """Make every error of ``app`` a problem document, and limit request bodies in size and time.

    ``explain``: the problem of a request that does not fit its schema. ``refuse``: see BodyLimit.
    ``advise``: what to do about a cause; documents have it as ``advice``.
    """
    app.state.advise = advise  # for those who refuse before the application is asked
    app.add_middleware(BodyLimit, limit=MAX_BODY_BYTES, within_s=BODY_WITHIN_S, refuse=refuse, advise=advise)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        return respond(advised(explain(error) | {"instance": request.url.path}, advise))

    @app.exception_handler(HTTPException)
    async def http_error(request: Request, error: HTTPException) -> JSONResponse:
        cause = "request." + HTTPStatus(error.status_code).name.lower()
        document = problem(error.status_code, cause, str(error.detail), instance=request.url.path)
        response = respond(advised(document, advise))
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(LongreachError)
    @app.exception_handler(Exception)
    async def failed(request: Request, error: Exception) -> JSONResponse:
        document = problem_of(error, status_of_cause) | {"instance": request.url.path}
        return respond(advised(document, advise))


_SWITCH_S = 0.0005  # a tenth of Python's own: how long a busy thread keeps the others from the interpreter

_FILES = 4096  # more than connections, also of those too many, so that one that asks for a stop is accepted


async def serve_in_thread(server: RestServer, listener: socket.socket) -> None:
    """Serve at ``listener``, which is bound, until ``server.should_exit``; the caller's loop goes on.

    Raises what the server raises. Once cancelled it ends the server first.
    """

    def serve() -> None:
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(server.serve([listener]))

    sys.setswitchinterval(_SWITCH_S)
    _allow_files(_FILES)
    with ThreadPoolExecutor(1, "rest") as thread:
        serving = asyncio.get_running_loop().run_in_executor(thread, serve)
        try:
            await asyncio.shield(serving)
        except asyncio.CancelledError:
            server.should_exit = True
            await serving
            raise


def _allow_files(count: int) -> None:
    """Let this process have ``count`` open files, or as many as it may."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < count:
        allowed = count if hard == resource.RLIM_INFINITY else min(count, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))
