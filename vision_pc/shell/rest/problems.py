"""Problems as RFC 9457 tells them: application/problem+json with a machine-readable ``cause``."""

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from protocol.errors import (
    ConfigurationError,
    DatagramRefused,
    FrameRefused,
    LinkLost,
    LongreachError,
    MeasurementFailed,
    RequestRefused,
)

MEDIA_TYPE = "application/problem+json"

_STATUS_OF_CAUSE = {
    "refused.unknown_operation": HTTPStatus.NOT_FOUND,
    "refused.key_reused": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.no_look_yet": HTTPStatus.NOT_FOUND,
    "refused.bad_target": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.bad_setting": HTTPStatus.UNPROCESSABLE_ENTITY,
}
_STATUS_OF_ERROR: tuple[tuple[type[LongreachError], HTTPStatus], ...] = (
    (RequestRefused, HTTPStatus.CONFLICT),
    (MeasurementFailed, HTTPStatus.UNPROCESSABLE_ENTITY),
    (LinkLost, HTTPStatus.SERVICE_UNAVAILABLE),
    (DatagramRefused, HTTPStatus.BAD_GATEWAY),
    (FrameRefused, HTTPStatus.BAD_GATEWAY),
    (ConfigurationError, HTTPStatus.UNPROCESSABLE_ENTITY),
)


def problem(status: int, cause: str, detail: str, **more: Any) -> dict[str, Any]:
    """The members of a problem document; ``more`` are its extensions."""
    title = HTTPStatus(status).phrase
    return {
        "type": f"urn:longreach:{cause}",
        "title": title,
        "status": status,
        "detail": detail,
        "cause": cause,
    } | more


def problem_of(error: Exception) -> dict[str, Any]:
    """The problem document of an exception; what was not raised on purpose tells nothing of its inside."""
    if not isinstance(error, LongreachError):
        return problem(HTTPStatus.INTERNAL_SERVER_ERROR, "internal", "an internal error; see the event log")
    status = _STATUS_OF_CAUSE.get(error.cause)
    if status is None:
        matching = (status for kind, status in _STATUS_OF_ERROR if isinstance(error, kind))
        status = next(matching, HTTPStatus.INTERNAL_SERVER_ERROR)
    return problem(status, error.cause, str(error))


def respond(document: dict[str, Any]) -> JSONResponse:
    """The response that carries a problem document."""
    return JSONResponse(document, status_code=document["status"], media_type=MEDIA_TYPE)


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


def _too_large(path: str) -> dict[str, Any]:
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    return problem(status, "request.too_large", "the request's body is too large", instance=path)


def install(app: FastAPI, max_body_bytes: int) -> None:
    """Makes every error of ``app`` a problem document, and limits request bodies."""

    app.add_middleware(BodyLimit, limit=max_body_bytes)

    @app.exception_handler(LongreachError)
    async def longreach_error(request: Request, error: LongreachError) -> JSONResponse:
        return respond(problem_of(error) | {"instance": request.url.path})

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        faults = [{"at": list(e["loc"]), "why": e["msg"]} for e in error.errors()[:20]]
        document = problem(
            HTTPStatus.UNPROCESSABLE_ENTITY, "request.invalid", f"{where}: {first['msg']}", faults=faults
        )
        return respond(document | {"instance": request.url.path})

    @app.exception_handler(HTTPException)
    async def http_error(request: Request, error: HTTPException) -> JSONResponse:
        if error.status_code == HTTPStatus.REQUEST_ENTITY_TOO_LARGE:
            return respond(_too_large(request.url.path))
        cause = "request." + HTTPStatus(error.status_code).name.lower()
        document = problem(error.status_code, cause, str(error.detail), instance=request.url.path)
        response = respond(document)
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(Exception)
    async def broken(request: Request, error: Exception) -> JSONResponse:
        return respond(problem_of(error) | {"instance": request.url.path})
