"""Problem documents (RFC 9457) with a machine-readable ``cause``."""

from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from protocol.errors import (
    ConfigurationError,
    DatagramRefused,
    FrameRefused,
    LinkLost,
    LongreachError,
    MeasurementFailed,
    MotionUnsettled,
    RequestRefused,
)

MEDIA_TYPE = "application/problem+json"
_STATUS_OF_ERROR: tuple[tuple[type[LongreachError], HTTPStatus], ...] = (
    (RequestRefused, HTTPStatus.CONFLICT),
    (MotionUnsettled, HTTPStatus.CONFLICT),
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


def problem_of(error: Exception, status_of_cause: Mapping[str, HTTPStatus]) -> dict[str, Any]:
    """The problem document of an exception; what was not raised on purpose tells nothing of its inside.

    ``status_of_cause``: the HTTP status of the causes that do not have the status of their kind of error.
    """
    if not isinstance(error, LongreachError):
        return problem(HTTPStatus.INTERNAL_SERVER_ERROR, "internal", "an internal error; see the event log")
    status = status_of_cause.get(error.cause)
    if status is None:
        matching = (status for kind, status in _STATUS_OF_ERROR if isinstance(error, kind))
        status = next(matching, HTTPStatus.INTERNAL_SERVER_ERROR)
    return problem(status, error.cause, str(error))
