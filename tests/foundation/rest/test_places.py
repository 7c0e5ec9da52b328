"""A server with few places: half-open requests yield to whoever asks, what is being served does not."""

import asyncio
import http.client
import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack

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
    """Return when ``condition()`` holds; fail after twenty seconds."""
    limit = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.005)


def asked(closing: ExitStack, place: Serving, path: str) -> http.client.HTTPConnection:
    """A connection that has sent a whole request; ``closing`` closes it."""
    connection = http.client.HTTPConnection("127.0.0.1", place.port, timeout=20.0)
    closing.callback(connection.close)
    connection.request("GET", path)
    return connection


def test_half_open_requests_yield_and_what_is_served_stays() -> None:
    release = threading.Event()
    with serving(app(release), places=PLACES) as place, ExitStack() as closing:
        closing.callback(release.set)
        connections = place.server.server_state.connections
        served = asked(closing, place, "/slow")
        until(lambda: len(place.server.server_state.tasks) == 1)
        for _ in range(3 * PLACES):
            half_open = closing.enter_context(socket.create_connection(("127.0.0.1", place.port)))
            half_open.sendall(HALF_OPEN)
        quick = asked(closing, place, "/thing")
        assert quick.getresponse().read() == b'"here"'
        until(lambda: len(connections) <= PLACES)
        release.set()
        assert served.getresponse().read() == b'"at last"'


def test_where_everybody_is_being_served_a_newcomer_is_told() -> None:
    release = threading.Event()
    with serving(app(release), places=PLACES) as place, ExitStack() as closing:
        closing.callback(release.set)
        served = [asked(closing, place, "/slow") for _ in range(PLACES)]
        until(lambda: len(place.server.server_state.tasks) == PLACES)
        late = asked(closing, place, "/thing")
        assert late.getresponse().status == 503
        release.set()
        assert [one.getresponse().status for one in served] == [200] * PLACES
