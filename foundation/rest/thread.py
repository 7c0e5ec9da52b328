"""A REST server in a thread and loop of its own: what strangers send is not read in the service's loop."""

import asyncio
import resource
import socket
import sys
from concurrent.futures import ThreadPoolExecutor

import uvloop

from foundation.rest.server import RestServer

_SWITCH_S = 0.0005  # a tenth of Python's own: how long a busy thread keeps the others from the interpreter

_FILES = 4096  # more than connections, also of those too many, so that one that asks for a stop is accepted


async def serve_in_thread(server: RestServer, listener: socket.socket) -> None:
    """Serve at ``listener``, which is bound, until ``server.should_exit``; the caller's loop goes on.

    Raises what the server raises. Once cancelled it ends the server first.
    """

    def serve() -> None:
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(server.serve([listener]))

    sys.setswitchinterval(_SWITCH_S)
    _allow_files(_FILES)
    with ThreadPoolExecutor(1, "rest") as thread:
        serving = asyncio.get_running_loop().run_in_executor(thread, serve)
        try:
            await asyncio.shield(serving)
        except asyncio.CancelledError:
            server.should_exit = True
            await serving
            raise


def _allow_files(count: int) -> None:
    """Let this process have ``count`` open files, or as many as it may."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < count:
        allowed = count if hard == resource.RLIM_INFINITY else min(count, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))
