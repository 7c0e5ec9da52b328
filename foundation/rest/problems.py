"""Problem documents (RFC 9457) with a machine-readable ``cause``."""

from collections import Counter
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any

from foundation.event_log import EventLog
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


NO_FRAMES = "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
DATA_POLICY = f"default-src 'none'; {NO_FRAMES}"
SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",  # no-referrer would make the Origin of our own pages "null"
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
DATA_HEADERS = SECURITY_HEADERS | {"Content-Security-Policy": DATA_POLICY}
_MOST_SOURCES = 256  # apart; those who come later are told together
Refusal = dict[str, Any]  # a problem document
Advise = Callable[[str], str]
"""Cause → what to do about it."""


def advised(document: Refusal, advise: Advise | None) -> Refusal:
    """A problem document with what to do about it, where anybody knows."""
    return document if advise is None else document | {"advice": advise(str(document["cause"]))}


class RefusalLog:
    """Counts refusals, as ``counts`` by cause, and writes them to ``log``, where there is one, by source."""

    def __init__(self, log: EventLog | None) -> None:
        self.counts: Counter[str] = Counter()
        self._log = log
        self._sources: set[str] = set()

    def tell(self, refusal: Refusal, source: str, count: int = 1) -> None:
        """So many more."""
        cause = refusal["cause"]
        self.counts[cause] += count
        if self._log is None:
            return
        if len(self._sources) < _MOST_SOURCES:
            self._sources.add(source)
        kind = cause, source if source in self._sources else None
        fields = {"cause": cause, "detail": refusal["detail"], "source": source}
        self._log.write_repeated(kind, "request_refused", "warning", **fields)
