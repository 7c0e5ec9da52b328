"""The REST face on a real port, over the synthetic arm, in a thread with a loop of its own."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator

from foundation.rest import RestServer
from tests.vision_pc.synthetic_station import bench
from vision_pc.shell.rest.api import create_app


@contextlib.contextmanager
def rest_face() -> Iterator[str]:
    """Its URL; the arm is enabled, and looks are quick."""
    listening = socket.create_server(("127.0.0.1", 0))
    started, leave = threading.Event(), threading.Event()

    async def serve() -> None:
        async with bench(link_timeout_ms=30_000) as made:  # this machine may be busy
            made.controller.speed = 50.0
            await made.post("/enable")
            server = RestServer(create_app(made.station, made.operations))
            task = asyncio.create_task(server.serve([listening]))
            started.set()
            await asyncio.to_thread(leave.wait)
            server.should_exit = True
            await task

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert started.wait(20.0)
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
    finally:
        leave.set()
        thread.join(20.0)
        listening.close()
