"""Our REST server over real sockets: whom it serves, whom it refuses, and how much of a body it reads."""

import asyncio
import contextlib
import http.client
import json
import re
import socket
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any, NamedTuple

import pytest
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, StreamingResponse
from pydantic import ValidationError

from foundation.configuration import HostName, StrictModel
from foundation.rest import door
from foundation.rest.guard import ANYBODY_HERE, Access, Guard, GuardedRequest
from foundation.rest.http_messages import MOST_BODY_BYTES
from foundation.rest.problems import SECURITY_HEADERS, RefusalLog
from foundation.rest.server import install_problems
from tests.foundation.rest.serving import serving
from tests.support.log_lines import HeardLog

SLOW_S = 0.5


class Answer(NamedTuple):
    """A response as it came over the wire."""

    status: int
    headers: dict[str, str]
    document: Any


class Served:
    """A small application behind our server: ``executed`` are the commands that got through."""

    def __init__(self, port: int, executed: list[bytes], log: HeardLog) -> None:
        self.port, self.executed, self.log = port, executed, log
        self.own = f"127.0.0.1:{port}"

    def connect(self) -> socket.socket:
        """A connection to it."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=20.0)

    def ask(
        self, method: str, path: str, *headers: str, host: str | None = None, body: bytes = b""
    ) -> Answer:
        """The answer to a request with exactly these headers."""
        lines = [f"{method} {path} HTTP/1.1", f"Host: {self.own if host is None else host}", *headers]
        if body:
            lines.append(f"Content-Length: {len(body)}")
        with self.connect() as sock:
            sock.sendall("\r\n".join([*lines, "Connection: close", "", ""]).encode() + body)
            return received(sock)


def received(sock: socket.socket) -> Answer:
    """The answer, read to the end of the connection."""
    whole = b""
    with contextlib.suppress(ConnectionResetError):  # what it did not read was thrown away
        while part := sock.recv(65536):
            whole += part
    head, _, body = whole.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines)}
    return Answer(int(first.split()[1]), headers, json.loads(body) if body else None)


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with served_app() as made:
        yield made


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """One with little patience for requests that do not come whole."""
    monkeypatch.setattr(door, "REQUEST_WITHIN_S", SLOW_S)
    with served_app() as made:
        yield made


@contextlib.contextmanager
def served_app() -> Iterator[Served]:
    """The small application, on a free port."""
    executed: list[bytes] = []
    log = HeardLog()
    app = FastAPI()
    install_problems(app, {})

    @app.post("/enable")
    async def enable(request: Request) -> dict[str, bool]:
        executed.append(await request.body())
        return {"accepted": True}

    @app.get("/state")
    async def state() -> dict[str, str]:
        return {"group_state": "disabled"}

    @app.get("/own-policy")
    async def own_policy() -> JSONResponse:
        return JSONResponse({}, headers={"Cache-Control": "max-age=60", "Content-Security-Policy": "sandbox"})

    @app.get("/slow")
    async def slow() -> dict[str, bool]:
        await asyncio.sleep(3 * SLOW_S)
        return {"slow": True}

    @app.get("/stream")
    async def stream() -> StreamingResponse:
        async def pieces() -> AsyncIterator[bytes]:
            while True:
                yield b"more"
                await asyncio.sleep(0.01)

        return StreamingResponse(pieces())

    @app.get("/broken")
    async def broken() -> None:
        raise ZeroDivisionError

    with serving(app, Access(("plc-cell", "10.1.2.3")), log) as where:
        yield Served(where.port, executed, log)
    log.close()


def refused(answer: Answer, status: int, cause: str) -> None:
    """It is a problem document of this cause, with the headers of every answer."""
    assert (answer.status, answer.document["cause"]) == (status, cause)
    assert answer.headers["content-type"] == "application/problem+json"
    secured(answer)


def secured(answer: Answer) -> None:
    for name, value in SECURITY_HEADERS.items():
        assert answer.headers[name.lower()] == value
    assert "frame-ancestors 'none'" in answer.headers["content-security-policy"]
    assert "server" not in answer.headers
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", "evil.example:8000", "127.0.0.1.evil.example", "localhost.evil.example", "",
        "127.0.0.1@evil.example", "10.1.2.4", "169.254.169.254", "plc-cell.example", "[::1", "127.0.0.1:x",
        "127.0.0.1, evil.example", "2130706433", "0.0.0.0",
    ],
)  # fmt: skip
def test_a_request_for_another_host_is_refused(served: Served, host: str) -> None:
    before = len(served.executed)
    refused(served.ask("GET", "/state", host=host), 421, "refused.foreign_host")
    refused(served.ask("POST", "/enable", host=host), 421, "refused.foreign_host")
    assert len(served.executed) == before


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1", "127.0.0.1:9000", "localhost", "LOCALHOST:8000", "localhost.", "[::1]:8000",
        "127.0.0.53", "plc-cell", "PLC-Cell:8000", "10.1.2.3:8000",
    ],
)  # fmt: skip
def test_loopback_and_configured_names_are_served(served: Served, host: str) -> None:
    assert served.ask("GET", "/state", host=host).status == 200


def test_a_request_whose_lines_end_in_line_feeds_alone_is_answered_at_once(served: Served) -> None:
    with served.connect() as sock:
        sock.settimeout(2.0)
        sock.sendall(b"POST /enable HTTP/1.1\nHost: localhost\n\n")
        assert b"CR LF is wanted" in sock.recv(65536)


@pytest.mark.parametrize(
    ("head", "status"),
    [
        (b"POST /enable HTTP/1.0", 421),
        (b"POST /enable HTTP/1.1\r\nHost: localhost\r\nHost: evil.example", 400),
        (b"POST /enable HTTP/1.1\r\nHost: localhost\r\nX: a\r\n folded: b", 400),
        (b"POST /enable HTTP/1.1\nHost: localhost", 400),
        (b"POST /enable HTTP/1.1\r\nHost: localhost\nX: a", 400),
        (b"POST /enable HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked", 400),
    ],
)
@pytest.mark.parametrize("before", [b"", b"GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n"])
def test_a_request_that_others_may_read_otherwise_is_refused_and_its_connection_ends(
    served: Served, before: bytes, head: bytes, status: int
) -> None:
    """No host, two of them, folded lines, bare line feeds, two lengths: a proxy reads one request, we two."""
    executed = len(served.executed)
    with served.connect() as sock:
        sock.sendall(before + head + b"\r\n\r\n0\r\n\r\nPOST /enable HTTP/1.1\r\nHost: localhost\r\n\r\n")
        said = b""
        while part := sock.recv(65536):
            said += part
    statuses = re.findall(rb"HTTP/1.1 ([0-9]+)", said)
    assert statuses == [b"200"] * bool(before) + [b"%d" % status]
    assert len(served.executed) == executed


@pytest.mark.parametrize("method", ["GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"])
@pytest.mark.parametrize(
    "headers",
    [
        ("Origin: http://evil.example:18999", "Sec-Fetch-Site: cross-site", "Sec-Fetch-Mode: no-cors"),
        ("Origin: http://127.0.0.1:18999", "Sec-Fetch-Site: same-site"),
        ("Sec-Fetch-Site: cross-site", "Sec-Fetch-Mode: navigate", "Sec-Fetch-Dest: iframe"),
        ("Sec-Fetch-Site: same-site",),
        ("Origin: null",),
        ("Origin: https://OWN",),
        ("Origin: http://OWN", "Origin: http://evil.example"),
        ("Origin: http://OWN", "Sec-Fetch-Site: cross-site"),
        ("Origin: http://OWN.evil.example",),
        ("Origin:",),
    ],
)
def test_a_page_of_another_origin_is_refused_whatever_it_asks(
    served: Served, headers: tuple[str, ...], method: str
) -> None:
    before = len(served.executed)
    sent = [header.replace("OWN", served.own) for header in headers]
    answer = served.ask(method, "/state" if method == "GET" else "/enable", *sent)
    if method == "HEAD":
        assert (answer.status, answer.document) == (403, None)
    else:
        refused(answer, 403, "refused.foreign_origin")
    assert len(served.executed) == before


@pytest.mark.parametrize(
    "headers",
    [
        (),
        ("User-Agent: curl/7.88.1", "Accept: */*"),
        ("Origin: http://OWN", "Sec-Fetch-Site: same-origin"),
        ("Sec-Fetch-Site: none", "Sec-Fetch-Mode: navigate"),
    ],
)
def test_programs_and_our_own_pages_are_served(served: Served, headers: tuple[str, ...]) -> None:
    before = len(served.executed)
    sent = [header.replace("OWN", served.own) for header in headers]
    assert served.ask("POST", "/enable", *sent, body=b"{}").status == 200
    assert served.executed[before:] == [b"{}"]
    assert served.ask("GET", "/state", *sent).document == {"group_state": "disabled"}


def test_every_answer_carries_the_headers(served: Served) -> None:
    for path, status in (("/state", 200), ("/nowhere", 404), ("/broken", 500)):
        answer = served.ask("GET", path)
        assert answer.status == status
        secured(answer)
        assert answer.headers["content-security-policy"].startswith("default-src 'none'; frame-ancestors")
    own = served.ask("GET", "/own-policy").headers
    assert (own["cache-control"], own["content-security-policy"]) == ("max-age=60", "sandbox")


@pytest.mark.parametrize("announced", [MOST_BODY_BYTES + 1, 50_000_000])
def test_a_body_announced_too_large_is_refused_before_it_comes(served: Served, announced: int) -> None:
    with served.connect() as sock:
        sock.sendall(
            f"POST /enable HTTP/1.1\r\nHost: x.localhost\r\nContent-Length: {announced}\r\n\r\n".encode()
        )
        refused(received(sock), 421, "refused.foreign_host")
    with served.connect() as sock:
        sock.sendall(
            f"POST /enable HTTP/1.1\r\nHost: localhost\r\nContent-Length: {announced}\r\n\r\n".encode()
        )
        refused(received(sock), 413, "request.too_large")


def test_a_body_in_chunks_is_refused_before_one_is_looked_at(served: Served) -> None:
    before = len(served.executed)
    with served.connect() as sock, contextlib.suppress(ConnectionError):
        sock.sendall(b"POST /enable HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n")
        refused(received(sock), 411, "request.length_wanted")
    assert len(served.executed) == before


@pytest.mark.realtime
def test_a_body_that_dribbles_is_given_up(hurried: Served) -> None:
    begun = time.monotonic()
    with hurried.connect() as sock:
        sock.sendall(b"POST /enable HTTP/1.1\r\nHost: localhost\r\nContent-Length: 10\r\n\r\n")
        for _ in range(4):
            time.sleep(SLOW_S / 8)
            sock.sendall(b"{")
        refused(received(sock), 408, "request.too_slow")
    assert time.monotonic() - begun >= SLOW_S
    assert hurried.executed == []


@pytest.mark.realtime
@pytest.mark.parametrize("first", [b"", b"GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n"])
def test_a_header_that_never_ends_ends_the_connection(hurried: Served, first: bytes) -> None:
    begun = time.monotonic()
    with hurried.connect() as sock:
        sock.sendall(first + b"POST /enable HTTP/1.1\r\n")
        got = b"."
        with contextlib.suppress(ConnectionError):
            while got and time.monotonic() - begun < 20 * SLOW_S:
                sock.sendall(b"X: 1\r\n")
                sock.settimeout(SLOW_S / 5)
                with contextlib.suppress(TimeoutError):
                    got = sock.recv(65536)
    assert SLOW_S <= time.monotonic() - begun < 20 * SLOW_S


@pytest.mark.realtime
def test_an_answer_may_take_its_time_and_the_connection_is_used_again(hurried: Served) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", hurried.port, timeout=20.0)
    try:
        connection.request("GET", "/slow")
        assert connection.getresponse().read() == b'{"slow":true}'
        before = connection.sock
        connection.request("POST", "/enable", body=b"again")
        assert connection.getresponse().read() == b'{"accepted":true}'
        assert connection.sock is before is not None
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("reached", "host", "status"),
    [
        ("10.0.0.7", "10.0.0.7:8000", 200),
        ("10.0.0.7", "127.0.0.1:8000", 200),  # a published port of a container
        ("10.0.0.7", "10.0.0.8:8000", 421),
        ("10.0.0.7", "7.0.0.10.example:8000", 421),
    ],
)
def test_bound_to_every_address_the_one_that_was_reached_is_served(
    reached: str, host: str, status: int
) -> None:
    asked = GuardedRequest("GET", "/state", [(b"host", host.encode())], "10.0.0.1", reached)
    refusal = Guard(ANYBODY_HERE, RefusalLog(None)).refusal(asked)
    assert (refusal["status"] if refusal else 200) == status


class _Names(StrictModel):
    hosts: tuple[HostName, ...] = ()


@pytest.mark.parametrize("name", ["*", "*.example", "a:8000", "http://a", "", "a b", "[::1]", "a/", "-a"])
def test_a_configured_host_is_a_name_alone(name: str) -> None:
    assert _Names(hosts=("vision", "vision-pc.cell", "10.0.0.7")).hosts[0] == "vision"
    with pytest.raises(ValidationError):
        _Names(hosts=(name,))


def test_head_is_answered_as_get_without_a_body_and_ends_streams_too(served: Served) -> None:
    """Load balancers, monitors and ``wget --spider`` ask so; a stream's HEAD must not last for ever."""
    for path, length in (("/state", "26"), ("/stream", None)):
        answer = served.ask("HEAD", path)
        assert (answer.status, answer.headers.get("content-length"), answer.document) == (200, length, None)
