"""A server with few places: half-open requests yield to whoever asks, what is being served does not."""

import asyncio
import http.client
import socket
import threading
import time
from collections.abc import Callable

import pytest
from fastapi import FastAPI

from foundation.rest.server import install_problems
from tests.foundation.rest.serving import Serving, serving

pytestmark = pytest.mark.realtime
PLACES = 8
HALF_OPEN = b"POST /thing HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{"


def app(release: threading.Event) -> FastAPI:
    """One that answers at once, takes a body, or waits for ``release``."""
    made = FastAPI()
    install_problems(made, {})

    @made.get("/thing")
    async def thing() -> str:
        return "here"

    @made.post("/thing")
    async def taken(body: dict[str, int]) -> dict[str, int]:
        return body

    @made.get("/slow")
    async def slow() -> str:
        await asyncio.to_thread(release.wait)
        return "at last"

    return made


def until(condition: Callable[[], bool]) -> None:
    """Return when ``condition()`` holds; fail after five seconds."""
    limit = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.005)


def asked(place: Serving, path: str) -> http.client.HTTPConnection:
    """A connection that has sent a whole request."""
    connection = http.client.HTTPConnection("127.0.0.1", place.port, timeout=5.0)
    connection.request("GET", path)
    return connection


def test_half_open_requests_yield_and_what_is_served_stays() -> None:
    release = threading.Event()
    with serving(app(release), places=PLACES) as place:
        connections = place.server.server_state.connections
        served = asked(place, "/slow")
        until(lambda: len(place.server.server_state.tasks) == 1)
        half_open = []
        for _ in range(3 * PLACES):
            half_open.append(socket.create_connection(("127.0.0.1", place.port)))
            half_open[-1].sendall(HALF_OPEN)
        until(lambda: len(connections) == PLACES)
        quick = asked(place, "/thing")
        assert quick.getresponse().read() == b'"here"'
        assert len(connections) <= PLACES
        release.set()
        assert served.getresponse().read() == b'"at last"'
        for one in (quick, served, *half_open):
            one.close()


def test_where_everybody_is_being_served_a_newcomer_is_told() -> None:
    release = threading.Event()
    with serving(app(release), places=PLACES) as place:
        served = [asked(place, "/slow") for _ in range(PLACES)]
        until(lambda: len(place.server.server_state.tasks) == PLACES)
        late = asked(place, "/thing")
        assert late.getresponse().status == 503
        release.set()
        assert [one.getresponse().status for one in served] == [200] * PLACES
        for one in (late, *served):
            one.close()
