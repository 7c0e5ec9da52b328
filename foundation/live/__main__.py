"""The live view, one process for all services: ``python -m foundation.live live.KEY=VALUE…``.

LONGREACH_LIVE names the Unix socket that it makes, and through which services with the same variable feed
it: only processes of the same user may connect.
"""

import asyncio
import os
import socket
import sys
from pathlib import Path

from foundation.configuration import parse_overrides, validated
from foundation.event_log import process_log
from foundation.live import LiveSettings
from foundation.live.server import LiveServer, access_of
from foundation.live.wire import FEEDS_VARIABLE
from foundation.secret_source import bound_tcp
from foundation.service_main import on_termination, say_ready
from protocol.errors import ConfigurationError, LongreachError

_REFUSED = 2
_NAME = "longreach: vision, controller, and the plant's truth"


async def _serve(server: LiveServer, listener: socket.socket, feeds: str) -> None:
    stop = asyncio.Event()
    on_termination(stop.set)
    async with await server.serve(listener), await asyncio.start_unix_server(server.fed, feeds):
        host, port = listener.getsockname()[:2]
        say_ready("live", viewers={"host": host, "port": port})
        await stop.wait()


def _run(server: LiveServer, listener: socket.socket, feeds: str) -> None:
    """Serve until asked to end. Raises ConfigurationError where no socket can be at ``feeds``."""
    try:
        asyncio.run(_serve(server, listener, feeds))
        Path(feeds).unlink(missing_ok=True)
    except OSError as error:
        why = f"{FEEDS_VARIABLE} = {feeds}: {error}"
        raise ConfigurationError("configuration.bad_address", why) from error


def main() -> int:
    """Exit status of the process."""
    os.umask(0o077)  # of the socket
    with process_log("live") as log:
        try:
            feeds = os.environ.get(FEEDS_VARIABLE)
            if not feeds:
                why = f"{FEEDS_VARIABLE} names the socket that services feed; it is not set"
                raise ConfigurationError("configuration.missing", why)
            given = parse_overrides(sys.argv[1:])
            if others := given.keys() - {"live"}:
                why = f"{', '.join(sorted(others))}: the live view has keys of live alone"
                raise ConfigurationError("configuration.unknown_key", why)
            settings = validated(LiveSettings, given.get("live", {}), "live")
            server = LiveServer(access_of(settings, "live"), log, _NAME)
            with bound_tcp(settings.host, settings.port, "live.port") as listener:
                _run(server, listener, feeds)
        except LongreachError as error:
            print(f"live: {error.cause}: {error}", file=sys.stderr)
            return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
