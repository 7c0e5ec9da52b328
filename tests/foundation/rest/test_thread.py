"""A REST server in a thread of its own: endpoints run at home, everything else does not wait for home."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import AsyncIterable, AsyncIterator

import httpx
import pytest
from fastapi import FastAPI
from fastapi.sse import EventSourceResponse, ServerSentEvent

from foundation.rest.files import Home, run_endpoints_at
from foundation.rest.server import RestServer, install_problems, serve_in_thread
from foundation.rest.tokens import ANYBODY_HERE
from protocol.errors import RequestRefused


class House:
    """An application that notes in which thread its endpoints run, and whether its followers have left."""

    def __init__(self) -> None:
        self.threads: list[int] = []
        self.left = asyncio.Event()
        self.app = FastAPI()
        install_problems(self.app, {})
        run_endpoints_at(self.app, Home(asyncio.get_running_loop()))

        @self.app.get("/state")
        async def state() -> dict[str, bool]:
            self.threads.append(threading.get_ident())
            return {"fine": True}

        @self.app.post("/refused")
        async def refused() -> None:
            await asyncio.sleep(0)
            raise RequestRefused("refused.busy", "an operation is running")

        @self.app.get("/events", response_class=EventSourceResponse)
        async def events() -> AsyncIterable[ServerSentEvent]:
            try:
                for number in range(1_000_000):
                    self.threads.append(threading.get_ident())
                    yield ServerSentEvent(data=number)
                    await asyncio.sleep(0.01)
            finally:
                self.left.set()


@contextlib.asynccontextmanager
async def lived_in() -> AsyncIterator[tuple[House, httpx.AsyncClient]]:
    house = House()
    server = RestServer(house.app, ANYBODY_HERE)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        serving = asyncio.create_task(serve_in_thread(server, listener))
        try:
            async with httpx.AsyncClient(base_url=url, timeout=20.0) as client:
                yield house, client
        finally:
            server.should_exit = True
            await asyncio.wait_for(serving, 10.0)
    with pytest.raises(httpx.ConnectError):
        await asyncio.to_thread(httpx.get, url)


async def test_endpoints_run_at_home_and_their_refusals_are_problems() -> None:
    async with lived_in() as (house, client):
        assert (await client.get("/state")).json() == {"fine": True}
        answer = await client.post("/refused")
        assert (answer.status_code, answer.json()["cause"]) == (409, "refused.busy")
        assert set(house.threads) == {threading.get_ident()}


async def test_who_follows_is_served_from_home_until_it_leaves() -> None:
    async with lived_in() as (house, client):
        async with client.stream("GET", "/events") as stream:
            lines = stream.aiter_lines()
            got = [line async for line, _ in zip_first(lines, 12) if line.startswith("data")]
            assert got[:3] == ["data: 0", "data: 1", "data: 2"]
        await asyncio.wait_for(house.left.wait(), 10.0)
        assert set(house.threads) == {threading.get_ident()}


async def zip_first(lines: AsyncIterator[str], count: int) -> AsyncIterator[tuple[str, int]]:
    """The first lines with their numbers."""
    for number in range(count):
        yield await anext(lines), number


async def test_what_is_refused_does_not_wait_for_home() -> None:
    async with lived_in() as (_, client):
        await client.get("/state")
        url = str(client.base_url)
        told: list[int] = []

        def stranger() -> None:
            strange = ({"Host": "evil.example"}, {"Origin": "http://evil.example"})
            told.extend(httpx.post(url, headers=header, timeout=20.0).status_code for header in strange)

        thread = threading.Thread(target=stranger)
        thread.start()
        thread.join(60.0)  # home is busy until then
        assert told == [421, 403]


async def test_a_service_that_is_cancelled_ends_its_server() -> None:
    house = House()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        serving = asyncio.create_task(serve_in_thread(RestServer(house.app, ANYBODY_HERE), listener))
        await asyncio.sleep(0.2)
        serving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asyncio.wait_for(serving, 10.0)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("rest")]
