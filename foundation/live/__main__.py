"""The live face as a process: of the service that started it, or shared by several.

``python -m foundation.live NAME SETTINGS [LISTENER LINK]``, settings as JSON. It takes over the two
sockets of one service, and ends when that does; without them it serves whoever of this user connects to the
abstract socket NAME, until it is asked to end.
"""

import asyncio
import os
import signal
import socket
import struct
import sys

from foundation.event_log import process_log
from foundation.live import LiveSettings
from foundation.live.feed import access_of
from foundation.live.server import LiveServer
from foundation.secret_source import bound_tcp
from foundation.service_main import on_termination, say_ready
from protocol.errors import LongreachError

_REFUSED = 2
_SHARED = "longreach: vision, controller, and the plant's truth"


async def _own(server: LiveServer, listener: socket.socket, link: socket.socket) -> None:
    reader, writer = await asyncio.open_connection(sock=link)
    async with await server.serve(listener):
        await server.fed(reader, writer)


async def _serve_shared(server: LiveServer, listener: socket.socket, feeds: socket.socket) -> None:
    stop = asyncio.Event()
    on_termination(stop.set)

    async def fed(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if _is_ours(writer.get_extra_info("socket")):
            await server.fed(reader, writer)
        else:
            writer.close()

    async with await server.serve(listener), await asyncio.start_unix_server(fed, sock=feeds):
        host, port = listener.getsockname()[:2]
        say_ready("live", viewers={"host": host, "port": port})
        await stop.wait()


def _is_ours(peer: socket.socket) -> bool:
    """Whether the process at the other end belongs to our own user: abstract sockets have no mode."""
    credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    return bool(struct.unpack("3i", credentials)[1] == os.getuid())


def main() -> int:
    """Exit status of the process."""
    name, text, *descriptors = sys.argv[1:]
    with process_log("live") as log:
        try:
            settings = LiveSettings.model_validate_json(text)
            server = LiveServer(access_of(settings, "live"), log, name if descriptors else _SHARED)
            if descriptors:
                # A signal to the whole process group reaches the service too, which then closes its end.
                for number in (signal.SIGINT, signal.SIGTERM):
                    signal.signal(number, signal.SIG_IGN)
                asyncio.run(_own(server, *(socket.socket(fileno=int(each)) for each in descriptors)))
                return 0
            with (
                bound_tcp(settings.host, settings.port or 0, "--foxglove") as listener,
                socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as feeds,
            ):
                feeds.bind("\0" + name)
                asyncio.run(_serve_shared(server, listener, feeds))
        except LongreachError as error:
            print(f"live: {error.cause}: {error}", file=sys.stderr)
            return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
