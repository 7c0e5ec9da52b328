"""Connections too many, and the lane of stops: what is served, what is refused, and in which order."""

import contextlib
import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator
from typing import NamedTuple

import pytest
from fastapi import FastAPI

from foundation.rest import connections
from foundation.rest.connections import MAX_OF_ONE_ADDRESS
from foundation.rest.problems import DATA_HEADERS
from foundation.rest.server import install_problems
from foundation.rest.tokens import Access
from tests.foundation.rest.serving import serving
from tests.support.log_lines import HeardLog

STOP = b"POST /stop HTTP/1.1\r\nHost: localhost\r\n\r\n"
GET = b"GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n"
BLOCK = b"GET /block HTTP/1.1\r\nHost: localhost\r\n\r\n"
SURPLUS_WITHIN_S = connections._SURPLUS_WITHIN_S
PATIENCE_S = 60  # no connection of a test ends because the machine is slow


class Api(NamedTuple):
    """``begun``: the requests that got through, in order. ``held`` is set while a block lasts."""

    port: int
    begun: list[str]
    log: HeardLog
    refused: dict[str, int]
    held: threading.Event
    release: threading.Event

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=20.0)


@pytest.fixture
def api(monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    monkeypatch.setattr(connections, "HEADERS_WITHIN_S", PATIENCE_S)
    monkeypatch.setattr(connections, "_SURPLUS_WITHIN_S", PATIENCE_S)
    begun: list[str] = []
    held, release = threading.Event(), threading.Event()
    app = FastAPI()
    install_problems(app, {})

    @app.post("/stop")
    async def stop() -> dict[str, bool]:
        begun.append("stop")
        return {"accepted": True}

    @app.get("/state")
    async def state() -> dict[str, str]:
        begun.append("state")
        return {"group_state": "disabled"}

    @app.get("/block")
    async def block() -> None:
        held.set()
        release.wait(PATIENCE_S)  # blocks the loop itself: what comes meanwhile comes all at once

    log = HeardLog()
    with serving(app, Access(stops=frozenset({"/stop"})), log) as where:
        where.server.config.timeout_keep_alive = PATIENCE_S
        yield Api(where.port, begun, log, where.server.refused, held, release)
    log.close()


@contextlib.contextmanager
def full(api: Api) -> Iterator[list[socket.socket]]:
    """As many connections as one address may have, each of them served once."""
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(api.connect()) for _ in range(MAX_OF_ONE_ADDRESS)]
        for sock in opened:
            sock.sendall(GET)
        assert {sock.recv(12) for sock in opened} == {b"HTTP/1.1 200"}
        yield opened


def one_answer(sock: socket.socket) -> bytes:
    """Everything to the end of a JSON document."""
    said = b""
    while not said.endswith(b"}"):
        part = sock.recv(65536)
        assert part
        said += part
    return said


def whole(sock: socket.socket) -> bytes:
    """Everything until the other side ends the connection."""
    said = b""
    with contextlib.suppress(ConnectionResetError):
        while part := sock.recv(65536):
            said += part
    return said


def test_a_connection_too_many_is_refused_with_a_problem(api: Api) -> None:
    with full(api) as opened:
        connection = http.client.HTTPConnection("127.0.0.1", api.port, timeout=20.0)
        connection.request("GET", "/state")
        answer = connection.getresponse()
        document = json.loads(answer.read())
        assert (answer.status, document["cause"]) == (503, "refused.too_many_connections")
        headers = DATA_HEADERS | {"Content-Type": "application/problem+json", "Connection": "close"}
        assert headers.items() <= dict(answer.headers).items()
        assert api.refused == {"refused.too_many_connections": 1}
        for sock in opened[:3]:
            sock.close()
        deadline = time.monotonic() + 10.0
        while True:  # those who leave make room
            with api.connect() as sock:
                sock.sendall(GET)
                if sock.recv(12) == b"HTTP/1.1 200":
                    break
            assert time.monotonic() < deadline
            time.sleep(0.05)
    assert api.log.lines()[0]["cause"] == "refused.too_many_connections"


@pytest.mark.parametrize("pieces", [1, 2, 5])
def test_a_stop_is_served_on_a_connection_too_many_and_nothing_after_it(api: Api, pieces: int) -> None:
    with full(api), api.connect() as sock:
        begun = len(api.begun)
        step = -(-len(STOP) // pieces)
        for at in range(0, len(STOP), step):
            sock.sendall(STOP[at : at + step])
            time.sleep(0.02)
        with contextlib.suppress(OSError):
            sock.sendall(GET)
        said = whole(sock)
        assert said.startswith(b"HTTP/1.1 200")
        assert said.count(b"HTTP/1.1") == 1
        assert api.begun[begun:] == ["stop"]


@pytest.mark.parametrize(
    "request_line", [b"POST /stopped HTTP/1.1", b"GET /stop HTTP/1.1", b"post /stop HTTP/1.1", b"X" * 64, b""]
)
def test_only_a_stop_is(api: Api, request_line: bytes) -> None:
    with full(api), api.connect() as sock:
        begun = len(api.begun)
        sock.sendall(request_line + b"\r\n")
        assert whole(sock).startswith(b"HTTP/1.1 503")
        assert len(api.begun) == begun


def test_who_says_nothing_on_a_connection_too_many_has_to_leave(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "_SURPLUS_WITHIN_S", SURPLUS_WITHIN_S)
    with full(api):
        began = time.monotonic()
        with api.connect() as sock:
            sock.sendall(b"POST /st")
            assert whole(sock) == b""  # within the 20 s for which the test waits: nothing else would end it
    assert time.monotonic() - began >= SURPLUS_WITHIN_S


def test_a_stop_that_comes_last_is_begun_first(api: Api) -> None:
    count = 100
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(api.connect()) for _ in range(count)]
        blocking, last = stack.enter_context(api.connect()), stack.enter_context(api.connect())
        for sock in (*opened, last):  # all are known to the loop
            sock.sendall(GET)
            assert one_answer(sock).startswith(b"HTTP/1.1 200")
        api.begun.clear()
        blocking.sendall(BLOCK)
        assert api.held.wait(20.0)
        for sock in opened:
            sock.sendall(GET)
        last.sendall(STOP)
        api.release.set()
        for sock in (last, *opened):
            assert one_answer(sock).startswith(b"HTTP/1.1 200")
    assert len(api.begun) == count + 1
    assert api.begun.index("stop") < count // 10


def test_a_client_that_does_not_wait_for_answers_is_ended_and_one_that_is_ahead_a_little_served(
    api: Api,
) -> None:
    """h11 keeps without a bound what comes before its turn: 1 GB in 8 s, and the link is lost."""
    with api.connect() as sock:
        sock.sendall(GET * 200 + GET.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n"))
        assert whole(sock).count(b"HTTP/1.1 200") == 201
    api.begun.clear()
    with api.connect() as sock, contextlib.suppress(ConnectionError):
        sock.sendall(GET * 100_000)
        whole(sock)  # the kernel may have taken it all: the server is still to come to it
    until_s = time.monotonic() + 20.0
    while not api.refused and time.monotonic() < until_s:
        time.sleep(0.01)
    assert len(api.begun) < 10_000
    assert api.refused == {"refused.too_far_ahead": 1}
