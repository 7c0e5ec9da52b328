"""The door of an HTTP API: every connection ends here, and the service behind gets whole requests alone.

A request is read, judged by the guard and only then handed on, over a Unix socket, one connection each. A
stop goes before everything that waits, also on a connection too many, and is begun here (``Stops``). Of
everything else a few are begun in every turn of the loop, and a few are with the service before it answers:
whatever strangers send, a turn stays short.
"""

import asyncio
import contextlib
import socket
from collections import Counter, OrderedDict, deque
from collections.abc import Awaitable
from http import HTTPStatus
from typing import Protocol

from foundation.rest.guard import Guard, GuardedRequest
from foundation.rest.http_messages import (
    MOST_BODY_BYTES,
    Head,
    RequestUnreadable,
    answer,
    chunk,
    framed,
    spelling,
    take_body,
    take_head,
)
from foundation.rest.problems import Refusal, problem
from foundation.rest.service_slots import ServiceSlots, allow_files

MAX_CONNECTIONS = 256
MAX_OF_ONE_ADDRESS = 128  # the other half is left for others
_MAX_SURPLUS = 1024  # connections too many that have not said what they want
_BEGUN_IN_A_TURN = 2  # requests
_BACKLOG = 1024  # connections that wait while one turn lasts
IDLE_S = 90.0  # longer than the 75 s for which proxies keep an idle connection
REQUEST_WITHIN_S = 10.0
SURPLUS_WITHIN_S = 1.0
_SPARED_S = 0.5  # for so long an idle connection does not yield to a newcomer
_WRITTEN_WITHIN_S = 30.0  # of a client that reads nothing
_MOST_AHEAD = 65_536  # bytes that a client may send before it is answered
_FIRST_LINE = 8_256
_PIECE = 65_536
_TOO_MANY = problem(
    HTTPStatus.SERVICE_UNAVAILABLE,
    "refused.too_many_connections",
    "too many connections; only stops are served",
)
_ABSENT = problem(
    HTTPStatus.SERVICE_UNAVAILABLE,
    "refused.service_absent",
    "the service behind this port does not answer: it starts, or ends",
)
_TOO_FAR_AHEAD = problem(
    HTTPStatus.TOO_MANY_REQUESTS,
    "refused.too_far_ahead",
    f"more than {_MOST_AHEAD} bytes came before the request in front of them was answered",
)


class Stops(Protocol):
    """What stops the arm without the service behind."""

    def begin(self, path: str) -> Awaitable[tuple[int, Refusal]] | None:
        """Stop it at once; the answer. None where there is nobody to tell: the service says why."""
        ...


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
        self.slots = ServiceSlots()

    async def serve(self, listener: socket.socket) -> asyncio.Server:
        """Serve at ``listener``, which is bound, until the server that is returned is closed."""
        allow_files()
        loop = asyncio.get_running_loop()
        return await loop.create_server(lambda: DoorConnection(self), sock=listener, backlog=_BACKLOG)

    def close(self) -> None:
        """End every connection."""
        for connection in (*self._inside, *self._surplus):
            connection.end()

    def enter(self, connection: "DoorConnection") -> bool:
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

    def leave(self, connection: "DoorConnection") -> None:
        """It has ended."""
        self._surplus.pop(connection, None)
        if connection in self._inside:
            del self._inside[connection]
            self._of_address[connection.address] -= 1
            self._of_address += Counter()  # those at none are forgotten

    def used(self, connection: "DoorConnection") -> None:
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

    def soon(self, connection: "DoorConnection") -> None:
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


class DoorConnection(asyncio.Protocol):
    """HTTP/1.1 on one connection. A request that does not come whole in time is answered 408."""

    def __init__(self, door: Door) -> None:
        self._door = door
        self.address, self._reached = "", ""
        self._received = bytearray()
        self._head: Head | None = None
        self._stopping: Awaitable[tuple[int, Refusal]] | None = None
        self._answering: asyncio.Task[None] | None = None
        self._deadline: asyncio.TimerHandle | None = None
        self._begun = self._queued = self._surplus = self._ending = False
        self._ahead: asyncio.Future[tuple[int, Refusal]] | None = None
        self._writable = asyncio.Event()
        self._writable.set()

    # asyncio's side
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._transport = transport
        self.address = str((transport.get_extra_info("peername") or ("",))[0])
        self._reached = str((transport.get_extra_info("sockname") or ("",))[0])
        self._free_s = asyncio.get_running_loop().time()
        self._surplus = not self._door.enter(self)
        self._wait(SURPLUS_WITHIN_S if self._surplus else IDLE_S)

    def data_received(self, data: bytes) -> None:
        if self._ending:
            return
        self._received += data
        if self._answering is None:
            self._consider()
        elif len(self._received) > _MOST_AHEAD:
            self._door.guard.counted(_TOO_FAR_AHEAD, self.address)
            self.end()
        else:
            self._begin_ahead()

    def pause_writing(self) -> None:
        self._writable.clear()

    def resume_writing(self) -> None:
        self._writable.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self._ending = True
        self._forget_deadline()
        self._door.leave(self)
        if self._answering is not None:
            self._answering.cancel()

    # The door's side
    @property
    def is_idle(self) -> bool:
        """Whether its client has had its time, and has no whole request to be answered."""
        waits = self._answering is None and not self._queued
        return waits and asyncio.get_running_loop().time() - self._free_s > _SPARED_S

    def end(self) -> None:
        """End the connection; what was not sent is not sent any more."""
        self._ending = True
        self._transport.abort()

    def go_on(self) -> None:
        """Read what has come, and begin to answer it once it is whole."""
        self._queued = False
        if self._ending or self._answering is not None:
            return
        try:
            self._head = self._head or self._admitted(take_head(self._received))
            if self._head is None:
                return
            body = take_body(self._received, self._head.length)
        except RequestUnreadable as error:
            self._refuse(self._door.guard.counted(error.document, self.address))
            return
        if body is not None or self._stopping is not None:  # a stop does not wait for a body
            self._forget_deadline()
            whole = self._answer(self._head, body or b"", body is not None)
            self._answering = asyncio.get_running_loop().create_task(whole)
            self._begin_ahead()

    def _consider(self) -> None:
        """A stop at once, also on a connection too many; everything else when its turn comes."""
        if not self._begun:
            self._begun = True
            if not self._surplus:
                self._wait(REQUEST_WITHIN_S)  # which pieces do not put off
        line, ended, _ = bytes(self._received[:_FIRST_LINE]).lstrip(b"\r\n").partition(b"\r\n")
        if self._head is None and ended and self._door.is_stop(line):
            self.go_on()
        elif not self._surplus:
            if not self._queued:
                self._queued = True
                self._door.soon(self)
        elif ended or len(self._received) >= _FIRST_LINE:
            self._refuse(self._door.guard.counted(_TOO_MANY, self.address))

    def _begin_ahead(self) -> None:
        """Begin a stop that came behind a request which is still being answered: its own answer waits."""
        if self._stopping or self._ahead or not self._received.startswith(b"POST "):  # next to no work
            return
        line, stops = bytes(self._received[:_FIRST_LINE]).partition(b"\r\n")[0], self._door.stops
        with contextlib.suppress(RequestUnreadable):  # which is answered in its turn, as a refusal is
            head = take_head(bytearray(self._received)) if stops and self._door.is_stop(line) else None
            stop = None if head is None else self._door.stop_of(head.target)
            if head and stop and stops and not self._door.guard.refusal(self._guarded_request(head, stop)):
                begun = stops.begin(stop)
                self._ahead = None if begun is None else asyncio.ensure_future(begun)

    def _admitted(self, head: Head | None) -> Head | None:
        """The head of a request whose body is wanted, a stop's as its path is written here; None: no further.

        Raises RequestUnreadable for a body that is too large, or that has no end.
        """
        if head is None:
            return None
        stop = self._door.stop_of(head.target)
        refusal = self._door.guard.refusal(self._guarded_request(head, stop))
        if refusal is not None:
            self._refuse(refusal, head)
        elif stop is not None and head.method == "OPTIONS":
            self._transport.write(answer(HTTPStatus.NO_CONTENT, None, head.keeps, Allow="OPTIONS, POST"))
            self._answered(head.keeps)
        elif stop is not None and head.method == "POST":
            self._stopping, self._ahead = self._ahead, None
            if self._stopping is None and self._door.stops is not None:
                self._stopping = self._door.stops.begin(stop)
            if head.endless is None or self._stopping is not None:
                return head._replace(target=stop)
            raise head.endless
        elif head.endless is not None:
            raise head.endless
        elif head.length > MOST_BODY_BYTES:
            why = f"a body of {head.length} bytes, at most {MOST_BODY_BYTES}"
            raise RequestUnreadable(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "request.too_large", why)
        else:
            if head.expects and len(self._received) < head.length:
                self._transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
            return head
        return None

    def _guarded_request(self, head: Head, stop: str | None) -> GuardedRequest:
        secure = head.values(b"x-forwarded-proto") == [b"https"] and self.address in ("127.0.0.1", "::1")
        scheme = "https" if secure else "http"
        return GuardedRequest(
            head.method, stop or head.path, head.fields, self.address, self._reached, scheme
        )

    def _refuse(self, refusal: Refusal, head: Head | None = None) -> None:
        """What is refused is not read: the connection ends."""
        response = answer(refusal["status"], refusal, keeps=False)
        only_head = head is not None and head.method == "HEAD"
        self._transport.write(response.partition(b"\r\n\r\n")[0] + b"\r\n\r\n" if only_head else response)
        self._close()

    async def _answer(self, head: Head, body: bytes, whole: bool) -> None:
        """Answer one request, and wait for the next; ``whole``: whether its body has been read."""
        keeps = head.keeps and whole and not self._surplus
        try:
            if self._stopping is not None:
                status, document = await self._stopping
                self._transport.write(answer(status, document, keeps))
            else:
                keeps = await self._relay(head, body, keeps)
        except (OSError, EOFError, TimeoutError, ValueError):
            self.end()  # the service has gone amid its answer, or the client reads nothing
        finally:
            self._stopping = self._answering = None
        self._answered(keeps)

    async def _relay(self, head: Head, body: bytes, keeps: bool) -> bool:
        """Have the service answer, and hand its answer on; whether the connection is kept."""
        role = self._door.guard.role_of(self._guarded_request(head, None)) or ""
        async with self._door.slots.slot() as leave:
            try:
                reader, writer = await asyncio.open_unix_connection(self._door.service, limit=_PIECE)
            except OSError:
                self._transport.write(answer(503, _ABSENT, keeps=False))
                return False
            try:
                writer.write(head.forwarded(body, longreach_role=role))
                answered = framed(await reader.readuntil(b"\r\n\r\n"), head, keeps)
                leave()
                self._transport.write(answered.head)
                left = answered.length
                while left != 0 and (data := await reader.read(_PIECE)):
                    left = None if left is None else left - len(data)
                    await self._write(chunk(data) if answered.in_chunks else data)
                if left:
                    raise EOFError
            finally:
                writer.close()
        if answered.in_chunks:
            self._transport.write(chunk(b""))
        return answered.keeps

    async def _write(self, data: bytes) -> None:
        """Raises TimeoutError for a client that reads nothing."""
        self._transport.write(data)
        async with asyncio.timeout(_WRITTEN_WITHIN_S):
            await self._writable.wait()

    def _answered(self, keeps: bool) -> None:
        self._head, self._begun = None, False
        if self._ending:
            return
        if not keeps:
            self._close()
            return
        self._door.used(self)
        self._free_s = asyncio.get_running_loop().time()
        self._wait(IDLE_S)
        if self._received:
            self._consider()

    def _close(self) -> None:
        self._ending = True
        self._forget_deadline()
        self._transport.close()

    def _late(self) -> None:
        if self._begun and not self._surplus:
            why = f"the request did not come whole within {REQUEST_WITHIN_S:g} s"
            late = problem(HTTPStatus.REQUEST_TIMEOUT, "request.too_slow", why)
            self._refuse(self._door.guard.counted(late, self.address))
        else:
            self._close()

    def _wait(self, for_s: float) -> None:
        self._forget_deadline()
        self._deadline = asyncio.get_running_loop().call_later(for_s, self._late)

    def _forget_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
