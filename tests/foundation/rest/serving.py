"""An application of ours behind its door on a real port, in a thread with a loop of its own."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from typing import Any, NamedTuple

from fastapi import FastAPI

from foundation.event_log import EventLog
from foundation.rest.door import Door, Stops
from foundation.rest.guard import ANYBODY_HERE, Access, Guard
from foundation.rest.problems import RefusalLog
from foundation.rest.server import RestServer, service_socket


class Serving(NamedTuple):
    """Where it listens, what was refused, by cause, and the loop in which both ends of it live."""

    port: int
    refused: dict[str, int]
    loop: asyncio.AbstractEventLoop


@contextlib.contextmanager
def serving(
    app: FastAPI,
    access: Access = ANYBODY_HERE,
    log: EventLog | None = None,
    *,
    stops: Stops | None = None,
    **places: Any,
) -> Iterator[Serving]:
    """``app``, served for as long as the block lasts."""
    started, leave = threading.Event(), threading.Event()
    refusals = RefusalLog(log)
    loops: list[asyncio.AbstractEventLoop] = []
    with socket.create_server(("127.0.0.1", 0)) as listening, service_socket() as (at, behind):

        async def serve() -> None:
            server = RestServer(app)
            door = Door(at, Guard(access, refusals), access.stops, stops, **places)
            task = asyncio.create_task(server.serve([behind]))
            front = await door.serve(listening)
            loops.append(asyncio.get_running_loop())
            started.set()
            await asyncio.to_thread(leave.wait)
            front.close()
            door.close()
            server.should_exit = True
            await task

        thread = threading.Thread(target=lambda: asyncio.run(serve()))
        thread.start()
        try:
            assert started.wait(20.0)
            yield Serving(listening.getsockname()[1], refusals.counts, loops[0])
        finally:
            leave.set()
            thread.join(20.0)
