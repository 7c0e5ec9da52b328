"""What every REST API of ours has: problem documents, a limit on bodies, a server in the service's loop."""

import contextlib
from collections.abc import Callable, Generator, Mapping
from http import HTTPStatus
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from foundation.problems import MEDIA_TYPE, problem, problem_of
from protocol.errors import LongreachError

MAX_BODY_BYTES = 16_384
_DRAIN_S = 1  # for answers under way at the end; a service must be gone within 2 s
_FAULTS_SHOWN = 20
Explain = Callable[[RequestValidationError], dict[str, Any]]


class RestServer(uvicorn.Server):
    """Uvicorn in the service's own loop: signals and log are the service's. ``serve`` takes bound sockets."""

    def __init__(self, app: FastAPI) -> None:
        super().__init__(
            uvicorn.Config(
                app,
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


class BodyLimit:
    """Refuses request bodies of more than ``limit`` bytes, announced or not, with a problem document."""

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self._app = app
        self._limit = limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        announced = dict(scope.get("headers", ())).get(b"content-length", b"0")
        if announced.isdigit() and int(announced) > self._limit:
            await respond(_too_large(scope["path"]))(scope, receive, send)
            return
        received = 0

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > self._limit:
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
            return message

        await self._app(scope, counted, send)


def respond(document: dict[str, Any]) -> JSONResponse:
    """The response that carries a problem document."""
    return JSONResponse(document, status_code=document["status"], media_type=MEDIA_TYPE)


def invalid_request(error: RequestValidationError) -> dict[str, Any]:
    """The problem of a request that does not fit its schema, with the first faults as ``faults``."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    faults = [{"at": list(each["loc"]), "why": each["msg"]} for each in error.errors()[:_FAULTS_SHOWN]]
    detail = f"{where}: {first['msg']}"
    return problem(HTTPStatus.UNPROCESSABLE_ENTITY, "request.invalid", detail, faults=faults)


def install_problems(
    app: FastAPI, status_of_cause: Mapping[str, HTTPStatus], explain: Explain = invalid_request
) -> None:
    """Make every error of ``app`` a problem document, and limit request bodies.

    ``explain``: the problem of a request that does not fit its schema.
    """
    app.add_middleware(BodyLimit, limit=MAX_BODY_BYTES)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        return respond(explain(error) | {"instance": request.url.path})

    @app.exception_handler(HTTPException)
    async def http_error(request: Request, error: HTTPException) -> JSONResponse:
        if error.status_code == HTTPStatus.REQUEST_ENTITY_TOO_LARGE:
            return respond(_too_large(request.url.path))
        cause = "request." + HTTPStatus(error.status_code).name.lower()
        document = problem(error.status_code, cause, str(error.detail), instance=request.url.path)
        response = respond(document)
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(LongreachError)
    @app.exception_handler(Exception)
    async def failed(request: Request, error: Exception) -> JSONResponse:
        return respond(problem_of(error, status_of_cause) | {"instance": request.url.path})


def _too_large(path: str) -> dict[str, Any]:
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    return problem(status, "request.too_large", "the request's body is too large", instance=path)
