"""Our REST server on a real port, in a thread with a loop of its own."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from typing import NamedTuple

from fastapi import FastAPI

from foundation.event_log import EventLog
from foundation.rest.server import RestServer
from foundation.rest.tokens import ANYBODY_HERE, Access


class Serving(NamedTuple):
    """Where it listens, and what serves there."""

    port: int
    server: RestServer


@contextlib.contextmanager
def serving(
    app: FastAPI, access: Access = ANYBODY_HERE, log: EventLog | None = None, places: int | None = None
) -> Iterator[Serving]:
    """``app``, served for as long as the block lasts."""
    started, leave = threading.Event(), threading.Event()
    server = RestServer(app, access, log, places)
    with socket.create_server(("127.0.0.1", 0)) as listening:

        async def serve() -> None:
            task = asyncio.create_task(server.serve([listening]))
            started.set()
            await asyncio.to_thread(leave.wait)
            server.should_exit = True
            await task

        thread = threading.Thread(target=lambda: asyncio.run(serve()))
        thread.start()
        try:
            assert started.wait(20.0)
            yield Serving(listening.getsockname()[1], server)
        finally:
            leave.set()
            thread.join(20.0)
