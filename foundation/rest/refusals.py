"""Problem documents as responses, and what every check of a request reads of it."""

from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from fastapi.responses import JSONResponse
from starlette.types import Scope

from foundation.problems import MEDIA_TYPE

Refusal = dict[str, Any]  # a problem document
Refuse = Callable[[Scope], Refusal | None]


def respond(document: Refusal) -> JSONResponse:
    """The response that carries a problem document."""
    return JSONResponse(document, status_code=document["status"], media_type=MEDIA_TYPE)


def respond_unread(document: Refusal) -> JSONResponse:
    """The same to a request whose body is not read: the connection ends, the rest of it is never taken."""
    response = respond(document)
    response.headers["Connection"] = "close"
    if document["status"] == HTTPStatus.UNAUTHORIZED:
        response.headers.append("WWW-Authenticate", 'Bearer realm="longreach"')
        response.headers.append("WWW-Authenticate", 'Basic realm="longreach", charset="UTF-8"')  # browsers
    return response


def header_values(scope: Scope, name: bytes) -> list[str]:
    """Every value of a header, in the order of the request; ``name`` in lower case."""
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]
