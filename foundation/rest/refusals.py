"""Problem documents as responses, and what every check of a request reads of it."""

from collections import Counter
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from fastapi.responses import JSONResponse
from starlette.types import Scope

from foundation.event_log import EventLog
from foundation.rest.problems import MEDIA_TYPE

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
_SOURCES_TOLD = 256  # apart; those who come later are told together
Refusal = dict[str, Any]  # a problem document
Refuse = Callable[[Scope], Refusal | None]


class RefusalLog:
    """Counts refusals, as ``counts`` by cause, and writes them to ``log``, where there is one, by source."""

    def __init__(self, log: EventLog | None) -> None:
        self.counts: Counter[str] = Counter()
        self._log = log
        self._sources: set[str] = set()

    def tell(self, refusal: Refusal, source: str) -> None:
        """One more."""
        cause = refusal["cause"]
        self.counts[cause] += 1
        if self._log is None:
            return
        if len(self._sources) < _SOURCES_TOLD:
            self._sources.add(source)
        kind = cause, source if source in self._sources else None
        fields = {"cause": cause, "detail": refusal["detail"], "source": source}
        self._log.write_repeated(kind, "request_refused", "warning", **fields)


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
