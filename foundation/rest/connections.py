"""Connections to a REST API: how many, how patient we are with them, and a lane for stops.

A request that begins with a path of the lane is parsed at once, whatever else waits, and also on a connection
too many. Of everything else a few are begun in every turn of the loop, so that a turn is short. Further
connections get a 503 that was made beforehand.
"""

import asyncio
import json
import re
from collections import Counter, OrderedDict, deque
from collections.abc import Iterable
from http import HTTPStatus
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from foundation.rest.problems import DATA_HEADERS, MEDIA_TYPE, RefusalLog, problem

HEADERS_WITHIN_S = 10.0  # beyond the 5 s for which uvicorn keeps an idle connection
MAX_CONNECTIONS = 256
MAX_OF_ONE_ADDRESS = 128  # the other half is left for others
_MAX_SURPLUS = 1024  # connections too many that have not said what they want
_SURPLUS_WITHIN_S = 1.0
_BEGUN_IN_A_TURN = 2  # requests
_LONGEST_LANE = 64  # bytes, of a request's beginning
_MAX_AHEAD = 65_536  # bytes that a client may send before it is answered
_LENIENT = re.compile(rb"(?<!\r)\n|\r\n[ \t]")  # a bare line feed, a folded line: proxies read them otherwise
_TOO_MANY = problem(
    HTTPStatus.SERVICE_UNAVAILABLE,
    "refused.too_many_connections",
    "too many connections; only stops are served",
    advice="Close other pages and programs that ask this service.",
)
_TOO_FAR_AHEAD = problem(
    HTTPStatus.TOO_MANY_REQUESTS,
    "refused.too_far_ahead",
    f"more than {_MAX_AHEAD} bytes came before the request in front of them was answered",
)


class Lanes:
    """What the connections of one server share. ``first``: paths whose POST is served before all others."""

    def __init__(self, first: Iterable[str], refusals: RefusalLog) -> None:
        self.refusals = refusals
        self._first = tuple(f"POST {path} ".encode() for path in first)
        self._open: Counter[str] = Counter()
        self._surplus: OrderedDict[Surplus, None] = OrderedDict()
        self._waiting: deque[LaneProtocol] = deque()
        self._left = _BEGUN_IN_A_TURN
        self._turning = False

    def is_first(self, data: bytes) -> bool:
        """Whether ``data`` begins a request of the lane."""
        return data.startswith(self._first)

    def enter(self, address: str) -> bool:
        """Whether a connection more from ``address`` is served; ``leave`` must follow then."""
        if self._open.total() >= MAX_CONNECTIONS or self._open[address] >= MAX_OF_ONE_ADDRESS:
            return False
        self._open[address] += 1
        return True

    def leave(self, address: str) -> None:
        """One of its connections has ended."""
        self._open[address] -= 1
        if not self._open[address]:
            del self._open[address]

    def keep_surplus(self, connection: "Surplus") -> None:
        """A connection too many, which may still ask for a stop; the longest silent has to make room."""
        self._surplus[connection] = None
        if len(self._surplus) > _MAX_SURPLUS:
            self._surplus.popitem(last=False)[0].end()

    def drop_surplus(self, connection: "Surplus") -> None:
        """It has said what it wants, or ended."""
        self._surplus.pop(connection, None)

    def may_begin(self, loop: asyncio.AbstractEventLoop) -> bool:
        """Whether a request may be begun in this turn of the loop."""
        if self._waiting or not self._left:
            return False
        self._left -= 1
        self._turn_soon(loop)
        return True

    def wait(self, connection: "LaneProtocol") -> None:
        """Have ``connection`` go on in one of the next turns."""
        self._waiting.append(connection)
        self._turn_soon(connection.loop)

    def _turn_soon(self, loop: asyncio.AbstractEventLoop) -> None:
        if not self._turning:
            self._turning = True
            loop.call_soon(self._turn, loop)

    def _turn(self, loop: asyncio.AbstractEventLoop) -> None:
        self._turning = False
        self._left = _BEGUN_IN_A_TURN
        while self._waiting and self._left:
            self._left -= 1
            self._waiting.popleft().go_on()
        if self._waiting:
            self._turn_soon(loop)


class Door(asyncio.Protocol):
    """Where every connection comes in: it gets a LaneProtocol, or is one too many."""

    def __init__(self, lanes: Lanes, **given: Any) -> None:
        self._lanes, self._given = lanes, given

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Decide what it is."""
        address = (transport.get_extra_info("peername") or ("",))[0]
        if self._lanes.enter(address):
            _go_on_as(LaneProtocol(self._lanes, address, **self._given), transport)
        else:
            _go_on_as(Surplus(self._lanes, address, self._given), transport)


class Surplus(asyncio.Protocol):
    """A connection too many: made of little, as there may be thousands. It may ask for a stop, once."""

    def __init__(self, lanes: Lanes, address: str, given: dict[str, Any]) -> None:
        self._lanes, self._address, self._given = lanes, address, given
        self._begun = b""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Its first line is due."""
        self._transport = transport
        self._lanes.keep_surplus(self)
        loop = asyncio.get_running_loop()
        self._deadline = loop.call_later(_SURPLUS_WITHIN_S, transport.close)

    def data_received(self, data: bytes) -> None:
        """Serve a stop; refuse anything else without reading on."""
        self._begun += data
        if len(self._begun) < _LONGEST_LANE and b"\n" not in self._begun:
            return
        self._forget()
        if self._lanes.is_first(self._begun):
            only = LaneProtocol(self._lanes, None, **self._given)
            _go_on_as(only, self._transport)
            only.data_received(self._begun)
        else:
            self._lanes.refusals.tell(_TOO_MANY, self._address)
            self._transport.write(_TOO_MANY_ANSWER)
            self._transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is due any more."""
        self._forget()

    def end(self) -> None:
        """End the connection."""
        self._transport.close()

    def _forget(self) -> None:
        self._deadline.cancel()
        self._lanes.drop_surplus(self)


class LaneProtocol(H11Protocol):
    """HTTP/1.1 on one connection. ``entered``: the address by which it counts; None: it is for one request.

    A connection ends whose next request does not arrive whole, but for its body, in time, and whose client
    does not wait for answers: uvicorn reads on while it answers, and h11 keeps what came without a bound.
    """

    def __init__(self, lanes: Lanes, entered: str | None, **given: Any) -> None:
        super().__init__(**given)
        self._lanes = lanes
        self._entered = entered
        self._deadline: asyncio.TimerHandle | None = None
        self._held = bytearray()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The first request is due. Where no place is free, the oldest that is not being served yields."""
        super().connection_made(transport)
        self._came_s = self.loop.time()
        self._await_request()
        if self.limit_concurrency is not None:
            self._make_room(self.limit_concurrency)

    def _make_room(self, limit: int) -> None:
        others = [other for other in self.connections if isinstance(other, LaneProtocol)]
        staying = [other for other in others if other is not self and not other.transport.is_closing()]
        idle = [other for other in staying if not other.is_served]
        if len(staying) + 1 >= limit and idle:
            min(idle, key=lambda other: other._came_s).transport.abort()

    @property
    def is_served(self) -> bool:
        """Whether a request has come whole and is being answered."""
        return self.cycle is not None and not (self.cycle.response_complete or self.cycle.more_body)

    def data_received(self, data: bytes) -> None:
        """A piece of a request; pieces do not put the deadline off."""
        if self._held:
            self._held += data
        elif self._lanes.is_first(data) or self._lanes.may_begin(self.loop):
            self._parse(data)
        else:
            self._held += data
            self.transport.pause_reading()
            self._lanes.wait(self)

    def go_on(self) -> None:
        """Parse what was held back."""
        data = bytes(self._held)
        self._held.clear()
        if not self.transport.is_closing():
            if not self.flow.read_paused:
                self.transport.resume_reading()
            self._parse(data)

    def handle_events(self) -> None:
        """Parse what has come; a request that others might read otherwise is answered 400."""
        if self.conn.their_state is h11.IDLE and _LENIENT.search(_head(self.conn)):
            self.send_400_response("Bare line feeds and folded lines are not read.")
        else:
            super().handle_events()

    def on_response_complete(self) -> None:
        """The next request is due; one that has come already is served at once."""
        super().on_response_complete()
        if self._entered is None:
            self.transport.close()
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is due any more."""
        super().connection_lost(exc)
        self._forget_deadline()
        if self._entered is not None:
            self._lanes.leave(self._entered)

    def _parse(self, data: bytes) -> None:
        super().data_received(data)
        self._await_request()
        if self.is_served and len(self.conn.trailing_data[0]) > _MAX_AHEAD:
            self._lanes.refusals.tell(_TOO_FAR_AHEAD, self.client[0] if self.client else "unknown")
            self.transport.abort()

    def _await_request(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self._forget_deadline()
        elif self._deadline is None and not self.transport.is_closing():
            self._deadline = self.loop.call_later(HEADERS_WITHIN_S, self.transport.close)

    def _forget_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


def _head(connection: h11.Connection) -> bytes:
    unparsed, _ = connection.trailing_data
    return unparsed.partition(b"\r\n\r\n")[0]


def _go_on_as(protocol: asyncio.Protocol, transport: asyncio.Transport) -> None:
    """Have ``protocol`` go on with a connection that is open."""
    transport.set_protocol(protocol)
    protocol.connection_made(transport)


def _answer(document: dict[str, Any]) -> bytes:
    body = json.dumps(document).encode()
    status = HTTPStatus(document["status"])
    headers = DATA_HEADERS | {
        "Content-Type": MEDIA_TYPE,
        "Content-Length": str(len(body)),
        "Connection": "close",
        "Retry-After": "1",
    }
    lines = [f"HTTP/1.1 {status.value} {status.phrase}", *(f"{name}: {v}" for name, v in headers.items())]
    return "\r\n".join([*lines, "", ""]).encode() + body


_TOO_MANY_ANSWER = _answer(_TOO_MANY)
