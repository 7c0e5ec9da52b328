"""The REST API behind its door on a real port, over the synthetic arm."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator, Mapping
from types import MappingProxyType

from foundation.rest.guard import Access, Role
from foundation.rest.server import RestServer, door, service_socket
from tests.vision_pc.synthetic_station import Bench, bench
from vision_pc.application.console.advice import advice
from vision_pc.shell.rest.api import STOPS, create_app
from vision_pc.shell.rest.console.routes import PUBLIC


@contextlib.contextmanager
def rest_face() -> Iterator[str]:
    """Its URL; the arm is enabled, and looks are quick."""
    with served_bench() as (url, _):
        yield url


@contextlib.contextmanager
def served_bench(
    enabled: bool = True,
    tokens: Mapping[Role, bytes] = MappingProxyType({}),
    link_timeout_ms: int = 30_000,
    emulator_face: str = "",
    port: int = 0,
    tries_valves: bool = False,
) -> Iterator[tuple[str, Bench]]:
    """Its URL, and what it works on; ``tokens``: who is asked; ``port``: 0 for any."""
    listening = socket.create_server(("127.0.0.1", port), backlog=512)
    started, leave = threading.Event(), threading.Event()
    benches: list[Bench] = []

    async def serve() -> None:
        async with bench(link_timeout_ms=link_timeout_ms, tries_valves=tries_valves) as made:
            made.controller.speed = 50.0
            if enabled:
                await made.post("/enable")
            app = create_app(made.station, made.operations, emulator_face=emulator_face)
            server, access = RestServer(app), Access((), tokens, frozenset(STOPS), PUBLIC, advise=advice)
            with service_socket() as (at, behind):
                task = asyncio.create_task(server.serve([behind]))
                async with door(listening, at, access, made.station.log):
                    benches.append(made)
                    started.set()
                    await asyncio.to_thread(leave.wait)
                server.should_exit = True
                await task

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert started.wait(20.0)
        yield f"http://127.0.0.1:{listening.getsockname()[1]}", benches[0]
    finally:
        leave.set()
        thread.join(20.0)
        listening.close()
