"""The door of an HTTP API: a way for stops, who is too many, who yields, answers handed on."""

import asyncio
import contextlib
import http.client
import json
import socket
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import NamedTuple

import pytest
from fastapi import FastAPI
from fastapi.responses import StreamingResponse

from foundation.rest import door
from foundation.rest.guard import Access
from foundation.rest.problems import DATA_HEADERS, Refusal
from foundation.rest.server import install_problems
from tests.foundation.rest.serving import serving
from tests.support.log_lines import HeardLog

STOP = b"POST /stop HTTP/1.1\r\nHost: localhost\r\n\r\n"
GET = b"GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n"
SLOW = b"GET /slow HTTP/1.1\r\nHost: localhost\r\n\r\n"
HALF_OPEN = b"POST /state HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{"
PLACES, OF_ONE = 8, 6
PATIENCE_S = 60.0  # no connection of a test ends because the machine is slow
pytestmark = pytest.mark.realtime


class CountedStops:
    """Stops that are begun at once, and answered at once."""

    def __init__(self) -> None:
        self.begun: list[str] = []

    def begin(self, path: str) -> Awaitable[tuple[int, Refusal]]:
        self.begun.append(path)
        return answered()


async def answered() -> tuple[int, Refusal]:
    return 200, {"accepted": True}


class Api(NamedTuple):
    """``begun``: the requests that the service has seen; ``release`` ends those to /slow and /block."""

    port: int
    begun: list[str]
    stops: CountedStops
    refused: dict[str, int]
    release: threading.Event
    blocked: threading.Event

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=20.0)


@pytest.fixture
def api(monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    monkeypatch.setattr(door, "SURPLUS_WITHIN_S", PATIENCE_S)
    begun: list[str] = []
    release, blocked = threading.Event(), threading.Event()
    app = FastAPI()
    install_problems(app, {})

    @app.get("/state")
    async def state() -> dict[str, str]:
        begun.append("state")
        return {"group_state": "disabled"}

    @app.get("/slow")
    async def slow() -> str:
        begun.append("slow")
        await asyncio.to_thread(release.wait, PATIENCE_S)
        return "at last"

    @app.get("/block")
    async def block() -> None:
        blocked.set()
        release.wait(PATIENCE_S)  # the loop itself: what comes meanwhile comes all at once

    @app.get("/pieces")
    async def pieces() -> StreamingResponse:
        async def each() -> AsyncIterator[bytes]:
            for number in range(3):
                yield b"%d" % number

        return StreamingResponse(each())

    @app.get("/large")
    async def large() -> StreamingResponse:
        return StreamingResponse(iter([b"x" * 1_000_000]), headers={"Content-Length": "1000000"})

    log, stops = HeardLog(), CountedStops()
    access = Access(stops=frozenset({"/stop", "/emergency-stop"}))
    with serving(app, access, log, stops=stops, places=PLACES, of_one_address=OF_ONE) as where:
        yield Api(where.port, begun, stops, where.refused, release, blocked)
        release.set()
    log.close()


def until(condition: Callable[[], bool]) -> None:
    """Return when ``condition()`` holds; fail after twenty seconds."""
    limit = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.005)


@contextlib.contextmanager
def full(api: Api) -> Iterator[list[socket.socket]]:
    """As many connections as one address may have, each of them waiting for its answer."""
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(api.connect()) for _ in range(OF_ONE)]
        for sock in opened:
            sock.sendall(SLOW)
        until(lambda: api.begun.count("slow") == OF_ONE)
        yield opened


def whole(sock: socket.socket) -> bytes:
    """Everything until the other side ends the connection."""
    said = b""
    with contextlib.suppress(ConnectionResetError):
        while part := sock.recv(65536):
            said += part
    return said


def one_answer(sock: socket.socket) -> bytes:
    """Everything to the end of a JSON document."""
    said = b""
    while not said.endswith((b"}", b'last"')):
        part = sock.recv(65536)
        assert part
        said += part
    return said


def status_of(api: Api) -> bytes:
    """Of one request on a connection of its own."""
    with api.connect() as sock:
        sock.sendall(GET)
        return sock.recv(12)


def test_a_connection_too_many_is_refused_with_a_problem_and_made_room_for_later(api: Api) -> None:
    with full(api):
        connection = http.client.HTTPConnection("127.0.0.1", api.port, timeout=20.0)
        connection.request("GET", "/state")
        answer = connection.getresponse()
        document = json.loads(answer.read())
        assert (answer.status, document["cause"]) == (503, "refused.too_many_connections")
        headers = DATA_HEADERS | {"Content-Type": "application/problem+json", "Connection": "close"}
        assert headers.items() <= dict(answer.headers).items()
        assert api.refused == {"refused.too_many_connections": 1}
        api.release.set()
    with api.connect() as sock:
        sock.sendall(GET)
        assert one_answer(sock).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize("pieces", [1, 2, 5])
def test_a_stop_is_served_on_a_connection_too_many_and_nothing_after_it(api: Api, pieces: int) -> None:
    with full(api), api.connect() as sock:
        step = -(-len(STOP) // pieces)
        for at in range(0, len(STOP), step):
            sock.sendall(STOP[at : at + step])
            time.sleep(0.02)
        with contextlib.suppress(OSError):
            sock.sendall(GET)
        said = whole(sock)
        assert said.startswith(b"HTTP/1.1 200")
        assert said.count(b"HTTP/1.1") == 1
    assert (api.stops.begun, "state" in api.begun) == (["/stop"], False)


@pytest.mark.parametrize(
    "target",
    [
        "/stop", "/stop/", "//stop", "/STOP", "/stop?now=1", "/%73top", "/./stop", "http://localhost/stop",
        "HTTP://localhost:80/stop/", "/emergency-stop", "/emergency_stop/", "/stop%20", "/stop.",
        "/stop;now=1", "/stop%C2%A0", "/EmergencyStop", "/emergency%20stop", "/stop#now",
    ],
)  # fmt: skip
def test_any_spelling_stops(api: Api, target: str) -> None:
    host = "localhost:80" if ":80" in target else "localhost"
    with full(api), api.connect() as sock:
        sock.sendall(f"POST {target} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        assert whole(sock).startswith(b"HTTP/1.1 200")
    assert api.stops.begun == ["/emergency-stop" if "mergency" in target else "/stop"]


@pytest.mark.parametrize(
    "length",
    [b"Transfer-Encoding: chunked", b"Transfer-Encoding: gzip, chunked", b"Content-Length: none",
     b"Content-Length: 0\r\nContent-Length: 0", b"Content-Length: 2\r\nTransfer-Encoding: chunked"],
)  # fmt: skip
def test_a_stop_goes_whatever_its_length_says_and_ends_the_connection(api: Api, length: bytes) -> None:
    with api.connect() as sock:
        sock.sendall(STOP.replace(b"\r\n\r\n", b"\r\n" + length + b"\r\n\r\n0\r\n\r\n") + GET)
        said = whole(sock)
    assert said.startswith(b"HTTP/1.1 200")
    assert said.count(b"HTTP/1.1") == 1
    assert (api.stops.begun, "state" in api.begun) == (["/stop"], False)


@pytest.mark.parametrize(
    "request_line",
    [b"POST /stopped HTTP/1.1", b"GET /stop HTTP/1.1", b"post /stop HTTP/1.1", b"POST /stop/x HTTP/1.1",
     b"X" * 64],
)  # fmt: skip
def test_nothing_else_does(api: Api, request_line: bytes) -> None:
    with full(api), api.connect() as sock:
        sock.sendall(request_line + b"\r\n\r\n\r\n")
        assert whole(sock).startswith(b"HTTP/1.1 503")
    assert api.stops.begun == []


@pytest.mark.parametrize(
    "head",
    [
        b"POST /stop HTTP/1.1\r\nHost: evil.example\r\n\r\n",
        b"POST http://evil.example/stop HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"POST /stop HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n\r\n",
        b"POST /state HTTP/1.1\r\nHost: localhost\r\nContent-Length: 40\r\n\r\n" + STOP[:40],
    ],
)
def test_no_page_of_another_origin_stops(api: Api, head: bytes) -> None:
    with api.connect() as sock:
        sock.sendall(head)
        assert sock.recv(12) in (b"HTTP/1.1 421", b"HTTP/1.1 403", b"HTTP/1.1 405")
    assert api.stops.begun == []


def test_what_may_be_asked_of_a_stop_is_told(api: Api) -> None:
    with api.connect() as sock:
        sock.sendall(b"OPTIONS /stop HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        said = whole(sock)
    assert said.startswith(b"HTTP/1.1 204")
    assert b"Allow: OPTIONS, POST" in said


def test_a_stop_waits_neither_for_its_body_nor_for_the_service(api: Api) -> None:
    with api.connect() as blocking, api.connect() as sock:
        sock.sendall(STOP.replace(b"\r\n\r\n", b"\r\nContent-Length: 500000\r\n\r\n{"))
        assert whole(sock).startswith(b"HTTP/1.1 200")
        blocking.sendall(GET)
    assert api.stops.begun == ["/stop"]


def test_who_says_nothing_on_a_connection_too_many_has_to_leave(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door, "SURPLUS_WITHIN_S", 1.0)
    with full(api):
        began = time.monotonic()
        with api.connect() as sock:
            sock.sendall(b"POST /st")
            assert whole(sock) == b""  # within the 20 s for which the test waits: nothing else would end it
    assert time.monotonic() - began >= 1.0


def test_a_stop_that_comes_last_is_begun_first(api: Api) -> None:
    count = 5
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(api.connect()) for _ in range(count)]
        last = stack.enter_context(api.connect())
        blocking = opened.pop()
        blocking.sendall(b"GET /block HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert api.blocked.wait(20.0)
        for sock in opened:
            sock.sendall(GET * 200)
        last.sendall(STOP)
        api.release.set()
        assert one_answer(last).startswith(b"HTTP/1.1 200")
        assert len(api.begun) < 50


def test_half_open_and_idle_connections_yield_and_what_is_served_stays(api: Api) -> None:
    with contextlib.ExitStack() as stack:
        served = stack.enter_context(api.connect())
        served.sendall(SLOW)
        until(lambda: "slow" in api.begun)
        for first in (HALF_OPEN, b""):
            for _ in range(3 * PLACES):
                stack.enter_context(api.connect()).sendall(first)
        until(lambda: status_of(api) == b"HTTP/1.1 200")
        api.release.set()
        assert one_answer(served).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize("pieces", [[SLOW, STOP], [SLOW + STOP], [SLOW + STOP[:20], STOP[20:]]])
def test_a_stop_behind_a_request_that_waits_is_begun_at_once_and_answered_in_its_turn(
    api: Api, pieces: list[bytes]
) -> None:
    with api.connect() as sock:
        for piece in pieces:
            sock.sendall(piece)
            until(lambda: api.begun == ["slow"])
        until(lambda: api.stops.begun == ["/stop"])
        api.release.set()
        received = b""
        while not received.endswith(b'{"accepted": true}'):
            received += one_answer(sock)
        assert b'"at last"HTTP/1.1 200 OK' in received
        assert api.stops.begun == ["/stop"]


def test_a_client_that_does_not_wait_for_answers_is_ended_and_one_that_is_ahead_a_little_served(
    api: Api,
) -> None:
    with api.connect() as sock:
        sock.sendall(GET * 200 + GET.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n"))
        assert whole(sock).count(b"HTTP/1.1 200") == 201
    api.begun.clear()
    with api.connect() as sock, contextlib.suppress(ConnectionError):
        sock.sendall(SLOW + GET * 100_000)
        whole(sock)
    until(lambda: bool(api.refused))
    assert api.refused == {"refused.too_far_ahead": 1}
    assert api.begun in ([], ["slow"])  # none of those behind it


def test_answers_are_handed_on_as_they_are(api: Api) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", api.port, timeout=20.0)
    for path, body in (("/pieces", b"012"), ("/large", b"x" * 1_000_000), ("/nowhere", None)):
        connection.request("GET", path)
        answer = connection.getresponse()
        said = answer.read()
        assert body is None or said == body
        assert answer.status == (404 if path == "/nowhere" else 200)
    sock = connection.sock
    assert sock is not None  # the connection was kept all along
    connection.close()
    with api.connect() as old:
        old.sendall(b"GET /pieces HTTP/1.0\r\nHost: localhost\r\n\r\n")
        assert whole(old).endswith(b"\r\n\r\n012")


def test_a_client_that_goes_away_ends_what_it_followed(api: Api) -> None:
    with api.connect() as sock:
        sock.sendall(SLOW)
        until(lambda: "slow" in api.begun)
    api.begun.clear()
    with full(api):  # its place is free again
        pass
