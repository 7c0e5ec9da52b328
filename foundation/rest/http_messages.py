"""HTTP/1.1 as the bytes of a connection: requests, read strictly and within bounds, and answers.

What two readers may read as two different requests is refused (RFC 9112, section 11.2): bare line feeds,
folded lines, two lengths, a length beside chunks. A body has an announced length: who sends chunks is
answered 411, as section 6.3 allows, because each of a chunk's bytes would have to be looked at.
"""

import json
import re
import sys
from http import HTTPStatus
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from foundation.rest.problems import DATA_HEADERS, MEDIA_TYPE, Refusal, problem

MOST_HEAD_BYTES = 16_384
MOST_FIELDS = 100
MOST_BODY_BYTES = 16_384
_LINE = re.compile(rb"([A-Z]{1,20}) ([!-~]{1,8192}) HTTP/1\.([0-9])")
_NAME = re.compile(rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]+")
_CONTROL = re.compile(rb"[\x00-\x08\x0a-\x1f\x7f]")
_HOP_BY_HOP = frozenset(
    (b"connection", b"keep-alive", b"proxy-connection", b"te", b"trailer", b"upgrade", b"expect")
)
Fields = tuple[tuple[bytes, bytes], ...]


class RequestUnreadable(Exception):
    """It is refused with ``document``, and nothing behind it is read."""

    def __init__(self, status: HTTPStatus, cause: str, detail: str) -> None:
        super().__init__(detail)
        self.document: Refusal = problem(status, cause, detail)


class Head(NamedTuple):
    """A request but for its body. ``fields``: names in lower case, values, in their order.

    ``target``: of this service, in origin form (``/path?query``), as it was sent. ``length``: bytes of the
    body. ``minor``: of the version of HTTP. ``endless``: why nobody knows where its body ends: what is not
    done without it is refused so.
    """

    method: str
    target: str
    fields: Fields
    length: int
    minor: int
    endless: RequestUnreadable | None = None

    @property
    def path(self) -> str:
        """The path as every server of ours decodes it."""
        return unquote(self.target.partition("?")[0])

    def values(self, name: bytes) -> list[bytes]:
        """Every value of a field."""
        return [value for key, value in self.fields if key == name]

    @property
    def keeps(self) -> bool:
        """Whether the client wants to use the connection again."""
        options = b",".join(self.values(b"connection")).lower()
        return b"close" not in options and (self.minor > 0 or b"keep-alive" in options)

    @property
    def expects(self) -> bool:
        """Whether the client waits to be told to send the body (RFC 9110, section 10.1.1)."""
        return any(value.lower() == b"100-continue" for value in self.values(b"expect"))

    def forwarded(self, body: bytes, **fields_of_ours: str) -> bytes:
        """The same request for the service behind: of HTTP/1.0, so that its answer ends with the connection.

        ``fields_of_ours`` speak for us; what the client sent under their names is left out. HEAD becomes the
        GET whose head it asks for.
        """
        ours = {name.replace("_", "-").encode(): value.encode() for name, value in fields_of_ours.items()}
        fields = [field for field in self.fields if field[0] not in _HOP_BY_HOP and field[0] not in ours]
        lines = [f"{'GET' if self.method == 'HEAD' else self.method} {self.target} HTTP/1.0".encode()]
        lines += [name + b": " + value for name, value in (*fields, *ours.items())]
        return b"\r\n".join((*lines, b"", body))


def spelling(target: str) -> str:
    """A target as whoever is in a hurry means it: small letters and digits, one slash before each part.

    Without host and query; blanks, dots, hyphens and underscores between and behind words go.
    """
    path = re.sub(r"[\s._-]+", "", unquote(re.sub(r"^[A-Za-z]+://[^/?#]*|[?#;].*", "", target)).lower())
    return "/" + "/".join(filter(None, path.split("/")))


def take_head(received: bytearray) -> Head | None:
    """The head at the beginning of ``received``, which is taken off it; None where it is not whole yet.

    Raises RequestUnreadable, but for a length that is doubtful (``endless``).
    """
    while received.startswith(b"\r\n"):  # RFC 9112, section 2.2
        del received[:2]
    end = received.find(b"\r\n\r\n", 0, MOST_HEAD_BYTES)
    if end < 0:
        if b"\n\n" in received:  # who types a request waits for an answer
            raise _malformed("its lines end in LF alone: CR LF is wanted")
        if len(received) >= MOST_HEAD_BYTES:
            why = f"a head of more than {MOST_HEAD_BYTES} bytes"
            status = HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE
            raise RequestUnreadable(status, "request.head_too_large", why)
        return None
    line, *lines = bytes(received[:end]).split(b"\r\n")
    match = _LINE.fullmatch(line)
    if match is None:
        raise _malformed(f"its first line is no request of HTTP/1.1: {line[:60]!r}")
    if len(lines) > MOST_FIELDS:
        raise _malformed(f"{len(lines)} fields, at most {MOST_FIELDS}")
    fields = tuple(_field(each) for each in lines)
    try:
        length, endless = _length(fields), None
    except RequestUnreadable as doubtful:
        length, endless = sys.maxsize, doubtful
    if sum(name == b"host" for name, _ in fields) > 1:
        raise _malformed("two Host fields")
    target, fields = _own_target(match[2].decode("ascii"), fields)
    del received[: end + 4]
    return Head(match[1].decode("ascii"), target, fields, length, int(match[3]), endless)


def take_body(received: bytearray, length: int) -> bytes | None:
    """The first ``length`` bytes, which are taken off ``received``; None where they have not all come."""
    if len(received) < length:
        return None
    body = bytes(received[:length])
    del received[:length]
    return body


def _field(line: bytes) -> tuple[bytes, bytes]:
    name, colon, value = line.partition(b":")
    value = value.strip(b" \t")
    if not colon or _NAME.fullmatch(name) is None or _CONTROL.search(value) is not None:
        raise _malformed(f"no header field: {line[:60]!r}")
    return name.lower(), value


def _length(fields: Fields) -> int:
    lengths = [value for name, value in fields if name == b"content-length"]
    coded = any(name == b"transfer-encoding" for name, _ in fields)
    if len(lengths) > 1 or (lengths and coded):
        why = "two lengths in one request: where it ends is nowhere written"
        raise RequestUnreadable(HTTPStatus.BAD_REQUEST, "request.ambiguous_length", why)
    if coded:
        why = "a body in chunks is not taken: announce its Content-Length"
        raise RequestUnreadable(HTTPStatus.LENGTH_REQUIRED, "request.length_wanted", why)
    if not lengths:
        return 0
    if re.fullmatch(rb"[0-9]{1,18}", lengths[0]) is None:
        raise _malformed(f"Content-Length: {lengths[0][:40]!r} is no length")
    return int(lengths[0])


def _own_target(target: str, fields: Fields) -> tuple[str, Fields]:
    """The target in origin form; the authority of an absolute one is a further host, unless it is that."""
    if target.startswith("/") or target == "*":
        return target, fields
    if not target.lower().startswith(("http://", "https://")):
        raise _malformed(f"target {target[:60]!r}: wanted a path")
    try:
        parts = urlsplit(target)
    except ValueError as error:
        raise _malformed(f"target {target[:60]!r}: {error}") from error
    own = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    authority = parts.netloc.encode()
    if [value for name, value in fields if name == b"host"] != [authority]:
        fields = (*fields, (b"host", authority))
    return own, fields


def _malformed(why: str) -> RequestUnreadable:
    return RequestUnreadable(HTTPStatus.BAD_REQUEST, "request.malformed", why)


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


def framed(head_bytes: bytes, head: Head, keeps: bool) -> Framed:
    """The head ``said`` of a service's answer as the client of ``head`` is to have it.

    Every answer carries SECURITY_HEADERS and a content policy where the service sets no others.
    """
    line, *lines = head_bytes.removesuffix(b"\r\n\r\n").split(b"\r\n")
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
    named = [*DATA_HEADERS.items(), *((name.replace("_", "-"), value) for name, value in fields.items())]
    if document is not None:
        named += [("Content-Type", MEDIA_TYPE if status >= HTTPStatus.BAD_REQUEST else "application/json")]
    if status != HTTPStatus.NO_CONTENT:
        named += [("Content-Length", str(len(body)))]
    if status == HTTPStatus.UNAUTHORIZED:
        named += _CHALLENGES
    if status == HTTPStatus.SERVICE_UNAVAILABLE:
        named += [("Retry-After", "1")]
    lines = [f"HTTP/1.1 {status} {HTTPStatus(status).phrase}", *(f"{name}: {value}" for name, value in named)]
    return "\r\n".join(lines).encode() + b"\r\n" + _connection(keeps) + b"\r\n\r\n" + body


def chunk(data: bytes) -> bytes:
    """A piece of a body without a length; the empty one ends it."""
    return b"%x\r\n%b\r\n" % (len(data), data)


def _connection(keeps: bool) -> bytes:
    return b"Connection: keep-alive" if keeps else b"Connection: close"
