"""Answers as the bytes of a connection: our own problem documents, and what a service behind has answered."""

import json
from http import HTTPStatus
from typing import Any, NamedTuple

from foundation.rest.problems import DATA_HEADERS, MEDIA_TYPE
from foundation.rest.requests import Head

_NOT_FORWARDED = frozenset({b"connection", b"keep-alive", b"transfer-encoding", b"server"})
_CHALLENGES = (
    ("WWW-Authenticate", 'Bearer realm="longreach"'),
    ("WWW-Authenticate", 'Basic realm="longreach", charset="UTF-8"'),  # browsers
)


class Framed(NamedTuple):
    """The head of an answer. ``length``: bytes of the body that follow; None: chunks, or all to the end."""

    head: bytes
    length: int | None
    in_chunks: bool
    keeps: bool


def framed(said: bytes, head: Head, keeps: bool) -> Framed:
    """The head ``said`` of a service's answer as the client of ``head`` is to have it.

    Every answer carries SECURITY_HEADERS and a content policy where the service sets no others.
    """
    line, *lines = said.removesuffix(b"\r\n\r\n").split(b"\r\n")
    fields = [(name.lower(), each) for each in lines for name, _, _ in (each.partition(b":"),)]
    status = int(line.split(b" ")[1])
    lengths = [int(each.partition(b":")[2]) for name, each in fields if name == b"content-length"]
    bodiless = head.method == "HEAD" or status in (HTTPStatus.NO_CONTENT, HTTPStatus.NOT_MODIFIED)
    length = 0 if bodiless else next(iter(lengths), None)
    in_chunks = length is None and head.minor > 0
    keeps = keeps and (length is not None or in_chunks)
    names = {name for name, _ in fields}
    ours = [f"{name}: {value}".encode() for name, value in DATA_HEADERS.items()]
    out = [b"HTTP/1.1 " + line.partition(b" ")[2]]
    out += [each for name, each in fields if name not in _NOT_FORWARDED]
    out += [each for each in ours if each.partition(b":")[0].lower() not in names]
    out += [b"Transfer-Encoding: chunked"] * in_chunks + [_connection(keeps)]
    return Framed(b"\r\n".join((*out, b"", b"")), length, in_chunks, keeps)


def answer(status: int, document: dict[str, Any] | None, keeps: bool, **fields: str) -> bytes:
    """A whole answer of our own; ``document``: None: none. An error is a problem document."""
    body = b"" if document is None else json.dumps(document).encode()
    said = [*DATA_HEADERS.items(), *((name.replace("_", "-"), value) for name, value in fields.items())]
    if document is not None:
        said += [("Content-Type", MEDIA_TYPE if status >= HTTPStatus.BAD_REQUEST else "application/json")]
    if status != HTTPStatus.NO_CONTENT:
        said += [("Content-Length", str(len(body)))]
    if status == HTTPStatus.UNAUTHORIZED:
        said += _CHALLENGES
    if status == HTTPStatus.SERVICE_UNAVAILABLE:
        said += [("Retry-After", "1")]
    lines = [f"HTTP/1.1 {status} {HTTPStatus(status).phrase}", *(f"{name}: {value}" for name, value in said)]
    return "\r\n".join(lines).encode() + b"\r\n" + _connection(keeps) + b"\r\n\r\n" + body


def chunk(data: bytes) -> bytes:
    """A piece of a body without a length; the empty one ends it."""
    return b"%x\r\n%b\r\n" % (len(data), data)


def _connection(keeps: bool) -> bytes:
    return b"Connection: keep-alive" if keeps else b"Connection: close"
