"""The plant's fieldbus face: a bus coupler's process image over Modbus TCP, served in the plant's own loop.

So that no master holds the loop up: a connection is served in slices, the strangers' together in one slice a
millisecond and in a twentieth of the time; the loop takes one new connection a step; there are only so many
places, and the writer keeps its own.
"""

import asyncio
import contextlib
import socket
from collections import deque
from collections.abc import Callable

from pymodbus.pdu import DecodePDU

from foundation.modbus import PlaceLost, StreamFramer
from plant_emulator.core.coupler.answers import CouplerAnswers
from plant_emulator.core.coupler.modbus_requests import Turns
from plant_emulator.core.layout import who_yields
from plant_emulator.shell.modbus_pdu import answer_to, request_of
from protocol.process_image import ValveImage

TURN_NS = 1_000_000  # between two slices of the others
# Of the time, for the others. Real-time processes that take most of a processor are held by the kernel for
# 50 ms at once, lest others starve: measured from 65 % on. No exchange survives it.
SHARE = 0.05
PLACES = 32
PLACES_OF_ONE_ADDRESS = 16
UNREAD_NS = 1_000_000_000  # answers that have waited so long for a master to read them end its connection
QUIET_NS = 60_000_000_000  # so does asking nothing, except for the writer
_LOOK_AROUND_S = 0.25
_SEND_BUFFER_BYTES = 32_768
_BACKLOG = 128
SLICE = 16  # requests that one step of the loop serves
_RECEIVE_BYTES = 4096
_FRAMER = StreamFramer(DecodePDU(is_server=True))


class Coupler(CouplerAnswers):
    """Serves the process image to several masters, one of which may write; see CouplerAnswers.

    ``clock_ns``: a monotonic clock; ``wall_ns``: what serving costs is measured by. ``silent`` is asked for
    each request: where it returns True, that is neither answered nor carried out, and connections stay open.
    """

    def __init__(
        self,
        sensor_words: Callable[[], list[int]],
        on_valves: Callable[[ValveImage], None],
        release_ns: int,
        clock_ns: Callable[[], int],
        silent: Callable[[], bool] = lambda: False,
        report: Callable[..., None] = lambda *_event, **_fields: None,
        wall_ns: Callable[[], int] | None = None,
    ) -> None:
        super().__init__(sensor_words, on_valves, release_ns, report)
        self.clock_ns, self.wall_ns = clock_ns, wall_ns or clock_ns
        self.silent = silent
        self._connections: set[CouplerConnection] = set()
        self._turns: deque[CouplerConnection] = deque()
        self._schedule = Turns(TURN_NS, SHARE)
        self._turning = False
        self._listener: socket.socket | None = None
        self._alarm: asyncio.TimerHandle | None = None
        self._alarm_ns = 0
        self._looking: asyncio.TimerHandle | None = None

    async def start(self, bound: socket.socket) -> tuple[str, int]:
        """Listen on a bound socket; returns its address. Raises OSError when somebody listens there."""
        bound.setblocking(False)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)  # inherited
        bound.listen(_BACKLOG)
        self._listener = bound
        asyncio.get_running_loop().add_reader(bound.fileno(), self._accept)
        self._look_around()
        host, port = bound.getsockname()
        return str(host), int(port)

    async def stop(self) -> None:
        """Close the listener and every connection."""
        for timer in (self._alarm, self._looking):
            if timer is not None:
                timer.cancel()
        self._alarm = self._looking = None
        if self._listener is not None:
            asyncio.get_running_loop().remove_reader(self._listener.fileno())
            self._listener.close()
            self._listener = None
        for connection in tuple(self._connections):
            connection.close()

    def answer(self, master: object, unit: int, pdu: bytes) -> bytes:
        """The response PDU to a request PDU; ``master`` is any object that stands for its connection."""
        now_ns = self.clock_ns()
        request = request_of(pdu)
        code, read = self.answered(master, request, now_ns)
        if self._watchdog.armed and (self._alarm is None or self._alarm_ns > self._watchdog.expires_at_ns()):
            self._set_alarm(now_ns)
        return answer_to(request, code, read)

    def wait_for_turn(self, connection: "CouplerConnection") -> None:
        """Serve ``connection`` in a later step of the loop, in which it gets its share of one slice."""
        if not self._turns and not self._turning:
            self._turn_later()
        self._turns.append(connection)

    def read_for(self, connection: "CouplerConnection", cost_ns: int) -> None:
        """Note what it took to read what a master sent."""
        if connection is not self.writer:
            self._schedule.spent(cost_ns)

    def lost_its_place(self, why: str) -> None:
        """Count a frame header that made no sense; its connection ends."""
        self._tell("framing_errors", "frame_refused", "coupler.framing", why)

    def disconnected(self, connection: "CouplerConnection") -> None:
        """A master has gone; the outputs keep their words until a watchdog acts."""
        self._connections.discard(connection)
        self.gone(connection)

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            sock, (address, _) = self._listener.accept()
        except OSError:  # it has gone again, or there are no more file handles: the next step tries anew
            return
        sock.setblocking(False)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.statistics.connections += 1
        kept = self.writer if isinstance(self.writer, CouplerConnection) else None
        yielding = who_yields(self._connections, address, kept, PLACES, PLACES_OF_ONE_ADDRESS)
        if yielding is not None:
            why = f"{len(self._connections)} connections; one of {yielding.address} yields to {address}"
            self._tell("displaced", "connection_closed", "coupler.no_place", why)
            yielding.close()
        self._connections.add(CouplerConnection(self, sock, address))

    def _turn_later(self) -> None:
        wait_ns = self._schedule.next_ns - self.wall_ns()
        loop = asyncio.get_running_loop()
        if wait_ns <= 0:
            loop.call_soon(self._take_turns)
        else:
            loop.call_later(1e-9 * wait_ns, self._take_turns)

    def _take_turns(self) -> None:
        began_ns = self.wall_ns()
        waiting = min(len(self._turns), SLICE)
        now, self._turns = list(self._turns)[:waiting], deque(list(self._turns)[waiting:])
        self._turning = True  # who waits again is served when it is known how long this turn took
        for connection in now:
            connection.serve(SLICE // waiting)
        self._turning = False
        self._schedule.took(began_ns, self.wall_ns())
        if self._turns:
            self._turn_later()

    def _look_around(self) -> None:
        """End connections that do not read their answers, and those that ask nothing."""
        now_ns = self.clock_ns()
        for connection in tuple(self._connections):
            if connection.blocked_ns is not None and now_ns - connection.blocked_ns >= UNREAD_NS:
                why = f"{connection.address} has not read its answers for {UNREAD_NS // 1_000_000} ms"
                self._tell("unread", "connection_closed", "coupler.unread", why)
            elif connection is not self.writer and now_ns - connection.heard_ns >= QUIET_NS:
                why = f"{connection.address} has asked nothing for {QUIET_NS // 1_000_000_000} s"
                self._tell("quiet", "connection_closed", "coupler.quiet", why)
            else:
                continue
            connection.close()
        self._looking = asyncio.get_running_loop().call_later(_LOOK_AROUND_S, self._look_around)

    def _set_alarm(self, now_ns: int) -> None:
        # One timer that looks again when the watchdog would expire, instead of one for every telegram.
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
        if self._listener is None or not self._watchdog.armed:
            return
        self._alarm_ns = self._watchdog.expires_at_ns()
        delay_s = max(self._alarm_ns - now_ns, 1_000_000) * 1e-9
        self._alarm = asyncio.get_running_loop().call_later(delay_s, self._alarmed)

    def _alarmed(self) -> None:
        now_ns = self.clock_ns()
        self.look_at_watchdog(now_ns)
        self._set_alarm(now_ns)


class CouplerConnection:
    """Serves slices of requests; reads on only when all of them are served and their answers are sent.

    So a master that pipelines without reading fills the buffers of its own socket and no memory of ours.
    A silent coupler swallows whole requests. ``blocked_ns``: since when answers wait to be read, or None.
    """

    def __init__(self, coupler: Coupler, sock: socket.socket, address: str) -> None:
        self.address = address
        self.served = 0
        self.heard_ns = coupler.clock_ns()
        self.blocked_ns: int | None = None
        self._coupler = coupler
        self._socket = sock
        self._held = b""  # has come and is not yet a whole request, or not yet served
        self._unsent = b""
        self._waits = False
        self._loop = asyncio.get_running_loop()
        self._listens = False
        self._listen(True)

    def close(self) -> None:
        """Close the connection at once."""
        if self._socket.fileno() < 0:
            return
        self._listen(False)
        self._loop.remove_writer(self._socket.fileno())
        self._socket.close()
        self._coupler.disconnected(self)

    def serve(self, most: int) -> None:
        """Answer up to ``most`` whole requests; wait for another turn while there may be more."""
        self._waits = False
        if self._socket.fileno() < 0:
            return
        answers, count = [], 0
        try:
            while count < most:
                used, unit, transaction, pdu = _FRAMER.decode(self._held)
                if not used:
                    break
                self._held = self._held[used:]
                count += 1
                if not self._coupler.silent():
                    answers.append(_FRAMER.encode(self._coupler.answer(self, unit, pdu), unit, transaction))
        except PlaceLost as lost:
            self._coupler.lost_its_place(str(lost))
            self._send(b"".join(answers))
            self.close()
            return
        if count:
            self.served += count
            self.heard_ns = self._coupler.clock_ns()
        if answers:
            self._send(answers[0] if count == 1 else b"".join(answers))
        if self.blocked_ns is not None or self._socket.fileno() < 0:
            return
        if count == most and self._held:
            self._wait()
        else:
            self._listen(True)

    def _readable(self) -> None:
        if self._waits:
            self._listen(False)  # lest what waits in the socket wakes the loop until the turn has come
            return
        began_ns = self._coupler.wall_ns()
        try:
            data = self._socket.recv(_RECEIVE_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.close()
            return
        self._held += data
        if self._coupler.writer is self:
            self.serve(SLICE)
        else:
            self._wait()
            self._coupler.read_for(self, self._coupler.wall_ns() - began_ns)

    def _listen(self, listen: bool) -> None:
        if listen and not self._listens:
            self._loop.add_reader(self._socket.fileno(), self._readable)
        elif self._listens and not listen:
            self._loop.remove_reader(self._socket.fileno())
        self._listens = listen

    def _wait(self) -> None:
        if not self._waits:
            self._waits = True
            self._coupler.wait_for_turn(self)

    def _send(self, data: bytes) -> None:
        try:
            sent = self._socket.send(data) if data else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self.close()
            return
        self._unsent = data[sent:] if sent < len(data) else b""
        if self._unsent and self.blocked_ns is None:
            self.blocked_ns = self._coupler.clock_ns()
            self._listen(False)
            self._loop.add_writer(self._socket.fileno(), self._writable)

    def _writable(self) -> None:
        self._send(self._unsent)
        if not self._unsent and self._socket.fileno() >= 0:
            self.blocked_ns = None
            self._loop.remove_writer(self._socket.fileno())
            self._listen(True)
            self._wait()
