"""The live face as a process: of the service that started it, or shared by several.

``python -m foundation.live own LISTENER LINK NAME`` takes over two sockets, and ends when the service does;
``python -m foundation.live shared NAME PORT ORIGIN…`` serves on loopback, without a token, whoever of this
user connects to the abstract socket NAME, until it is asked to end; pages of each ORIGIN may look. Other
settings come as JSON on stdin.
"""

import argparse
import asyncio
import os
import signal
import socket
import struct
import sys
from collections.abc import Sequence

from foundation.event_log import EventLog, process_log
from foundation.live import LiveSettings
from foundation.live.face import LiveFace
from foundation.live.feed import access_of
from foundation.periods import take_policy
from foundation.secret_source import bound_tcp
from foundation.service_main import say_ready, signs_of_life, when_asked_to_end
from protocol.errors import LongreachError

_REFUSED = 2


async def _own(
    settings: LiveSettings, listener: socket.socket, link: socket.socket, name: str, log: EventLog
) -> None:
    face = LiveFace(access_of(settings, "live"), log, name)
    reader, writer = await asyncio.open_connection(sock=link)
    async with await face.serve(listener):
        await face.fed(reader, writer)


async def _serve_shared(name: str, port: int, origins: Sequence[str], log: EventLog) -> None:
    settings = LiveSettings(port=port, allowed_origins=tuple(origins))
    stop = asyncio.Event()
    when_asked_to_end(stop.set)
    face = LiveFace(access_of(settings, "live"), log, "longreach: vision, controller, and the plant's truth")
    with (
        bound_tcp(settings.host, port, "--foxglove") as listener,
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as feeds,
    ):
        feeds.bind("\0" + name)

        async def fed(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            if _is_ours(writer.get_extra_info("socket")):
                await face.fed(reader, writer)
            else:
                writer.close()

        async with (
            await face.serve(listener),
            await asyncio.start_unix_server(fed, sock=feeds),
            signs_of_life(),
        ):
            host, port = listener.getsockname()[:2]
            say_ready("live", viewers={"host": host, "port": port})
            await stop.wait()


def _is_ours(peer: socket.socket) -> bool:
    """Whether the process at the other end belongs to our own user: abstract sockets have no mode."""
    credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    return bool(struct.unpack("3i", credentials)[1] == os.getuid())


def main() -> int:
    """Exit status of the process."""
    parser = argparse.ArgumentParser("python -m foundation.live", description=__doc__)
    parser.add_argument("whose", choices=("own", "shared"))
    parser.add_argument("sockets", nargs="+")
    arguments = parser.parse_args()
    with process_log("live") as log:
        try:
            if arguments.whose == "shared":
                name, port, *origins = arguments.sockets
                asyncio.run(_serve_shared(name, int(port), origins, log))
                return 0
            # A signal to the whole process group reaches the service too, which then closes its end.
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_IGN)
            settings = LiveSettings.model_validate_json(sys.stdin.buffer.read())
            listener, link = (socket.socket(fileno=int(number)) for number in arguments.sockets[:2])
            take_policy("batch")
            asyncio.run(_own(settings, listener, link, arguments.sockets[2], log))
        except LongreachError as error:
            print(f"live: {error.cause}: {error}", file=sys.stderr)
            return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
