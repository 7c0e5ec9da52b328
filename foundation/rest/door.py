"""The door of an HTTP API: every connection ends here, and the service behind gets whole requests alone.

A request is read, judged by the guard and only then handed on, over a Unix socket, one connection each. A
stop goes before everything that waits, also on a connection too many, and is begun here (``Stops``). Of
everything else a few are begun in every turn of the loop, and a few are with the service before it answers:
whatever strangers send, a turn stays short.
"""

import asyncio
import contextlib
import resource
import socket
from collections import Counter, OrderedDict, deque
from collections.abc import AsyncIterator

from foundation.rest.door_connection import DoorConnection, Stops
from foundation.rest.guard import Guard
from foundation.rest.http_messages import spelling

MAX_CONNECTIONS = 256
MAX_OF_ONE_ADDRESS = 128  # the other half is left for others
_MAX_SURPLUS = 1024  # connections too many that have not said what they want
_BEGUN_IN_A_TURN = 2  # requests
_AT_THE_SERVICE = 4  # requests that it has not begun to answer
_ANSWERED_WITHIN_S = 0.25  # who waits longer waits for something else than its processor
_BACKLOG = 1024  # connections that wait while one turn lasts
_FILES = 4096  # more than connections, so that one too many that asks for a stop is accepted


class Door:
    """Lets requests in to the service at ``service``, the path of its socket.

    ``stop_paths``: whose POST is a stop, in whatever spelling. ``stops``: who begins it; None: the service.
    """

    def __init__(
        self,
        service: str,
        guard: Guard,
        stop_paths: frozenset[str] = frozenset(),
        stops: Stops | None = None,
        places: int = MAX_CONNECTIONS,
        of_one_address: int = MAX_OF_ONE_ADDRESS,
    ) -> None:
        self.service, self.guard, self.stops = service, guard, stops
        self._stop_of = {spelling(path): path for path in stop_paths}
        self._places, self._of_one = places, of_one_address
        self._inside: dict[DoorConnection, None] = {}
        self._of_address: Counter[str] = Counter()
        self._surplus: OrderedDict[DoorConnection, None] = OrderedDict()
        self._waiting: deque[DoorConnection] = deque()
        self._turning = False
        self._unanswered = asyncio.Semaphore(_AT_THE_SERVICE)

    async def serve(self, listener: socket.socket) -> asyncio.Server:
        """Serve at ``listener``, which is bound, until the server that is returned is closed."""
        _allow_files()
        loop = asyncio.get_running_loop()
        return await loop.create_server(lambda: DoorConnection(self), sock=listener, backlog=_BACKLOG)

    def close(self) -> None:
        """End every connection."""
        for connection in (*self._inside, *self._surplus):
            connection.end()

    def enter(self, connection: DoorConnection) -> bool:
        """Whether it is served; one too many may still ask for a stop. ``leave`` must follow in either case.

        Where no place is free, the longest idle yields: of all, or of the address that has its share.
        """
        address = connection.address
        full = len(self._inside) >= self._places
        if full or self._of_address[address] >= self._of_one:
            idle = (one for one in self._inside if one.is_idle and (full or one.address == address))
            yielding = next(idle, None)
            if yielding is None:
                self._surplus[connection] = None
                if len(self._surplus) > _MAX_SURPLUS:
                    next(iter(self._surplus)).end()
                return False
            self.leave(yielding)
            yielding.end()
        self._inside[connection] = None
        self._of_address[address] += 1
        return True

    def leave(self, connection: DoorConnection) -> None:
        """It has ended."""
        self._surplus.pop(connection, None)
        if connection in self._inside:
            del self._inside[connection]
            self._of_address[connection.address] -= 1
            self._of_address += Counter()  # those at none are forgotten

    def used(self, connection: DoorConnection) -> None:
        """It has been answered: it has been idle for the shortest time."""
        if connection in self._inside:
            del self._inside[connection]
            self._inside[connection] = None

    def stop_of(self, target: str) -> str | None:
        """The path of the stop that ``target`` names, in whatever spelling."""
        return self._stop_of.get(spelling(target))

    def is_stop(self, line: bytes) -> bool:
        """Whether the first line of a request asks for a stop."""
        method, _, rest = line.partition(b" ")
        return method == b"POST" and self.stop_of(rest.split(b" ")[0].decode("latin-1")) is not None

    def soon(self, connection: DoorConnection) -> None:
        """Have ``connection`` go on in this turn of the loop, or in one of the next."""
        self._waiting.append(connection)
        if not self._turning:
            self._turning = True
            asyncio.get_running_loop().call_soon(self._turn)

    def _turn(self) -> None:
        for _ in range(min(_BEGUN_IN_A_TURN, len(self._waiting))):
            self._waiting.popleft().go_on()
        self._turning = bool(self._waiting)
        if self._turning:
            asyncio.get_running_loop().call_soon(self._turn)

    @contextlib.asynccontextmanager
    async def slot(self) -> AsyncIterator["ServiceSlot"]:
        """A place among those that the service has not begun to answer."""
        await self._unanswered.acquire()
        slot = ServiceSlot(self._unanswered)
        try:
            yield slot
        finally:
            slot.leave()


class ServiceSlot:
    """It is left once, after a short while in any case."""

    def __init__(self, places: asyncio.Semaphore) -> None:
        self._places: asyncio.Semaphore | None = places
        self._late = asyncio.get_running_loop().call_later(_ANSWERED_WITHIN_S, self.leave)

    def leave(self) -> None:
        """Let another in."""
        if self._places is not None:
            self._late.cancel()
            self._places.release()
            self._places = None


def _allow_files() -> None:
    """Let this process have as many open files as it may, up to ``_FILES``."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < _FILES:
        allowed = _FILES if hard == resource.RLIM_INFINITY else min(_FILES, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))
