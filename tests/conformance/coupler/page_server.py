"""The page's coupler on a socket: the stream cut into frames as clause 1 says, by the same rules."""

import asyncio
import socket
import struct
from typing import cast

from tests.conformance.coupler.page_coupler import PageCoupler
from tests.conformance.coupler.rules import Rules
from tests.conformance.couplers import ShiftedClock, Threaded

_HEAD = struct.Struct(">HHHB")


class PageConnection(asyncio.Protocol):
    """Cuts the stream into frames, as clause 1 says."""

    def __init__(self, server: "PageServer") -> None:
        self._server = server
        self._buffer = b""
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        if len(self._server.connections) >= self._server.rules.connections:
            self._transport.abort()
        self._server.connections.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.connections.discard(self)
        self._server.coupler.closed(self, self._server.now_ns())
        if self._buffer and "hang-up" in self._server.rules.one_ends_all:
            self._server.end_all()

    def end(self) -> None:
        """Close at once."""
        assert self._transport is not None
        self._transport.close()

    def data_received(self, data: bytes) -> None:
        rules = self._server.rules
        self._buffer += data
        answers: list[bytes] = []
        while len(self._buffer) >= _HEAD.size:
            transaction, protocol, length, unit = _HEAD.unpack_from(self._buffer)
            if protocol & rules.protocol_bits or not rules.least_length <= length <= rules.most_length:
                self._lost(answers)
                return
            end = _HEAD.size - 1 + length
            if len(self._buffer) < end and (rules.waits_for_the_whole or len(self._buffer) == _HEAD.size):
                break
            pdu, self._buffer = self._buffer[_HEAD.size : end], self._buffer[end:]
            answers.append(self._answer(transaction, unit, pdu))
        self._send(answers[: rules.answers_of_a_piece])

    def _answer(self, transaction: int, unit: int, pdu: bytes) -> bytes:
        if not pdu:  # only where a mutant takes a length of 1
            return b""
        answer = self._server.coupler.answer(self, pdu, self._server.now_ns())
        transaction, unit = self._server.rules.header(transaction, unit, answer)
        return _HEAD.pack(transaction, 0, len(answer) + 1, unit) + answer

    def _send(self, answers: list[bytes]) -> None:
        assert self._transport is not None
        self._transport.write(b"".join(answers if self._server.rules.in_order else reversed(answers)))

    def _lost(self, answers: list[bytes]) -> None:
        rules = self._server.rules
        self._server.coupler.lost()
        if rules.answers_what_is_lost:
            answers = [*answers, self._answer(0, 1, self._buffer[_HEAD.size :] or b"\0")]
        self._buffer = b""
        self._send(answers if rules.answers_before_it else [])
        if rules.closes_what_is_lost:
            self.end()
        if "lost frame" in rules.one_ends_all:
            self._server.end_all()


class PageServer(Threaded):
    """A context in which the coupler listens on ``port``."""

    def __init__(self, rules: Rules, clock: ShiftedClock) -> None:
        super().__init__()
        self.rules = rules
        self.coupler = PageCoupler(rules)
        self.connections: set[PageConnection] = set()
        self.now_ns = clock.monotonic_ns

    def end_all(self) -> None:
        """Close every connection."""
        for each in tuple(self.connections):
            each.end()

    async def serve(self, bound: socket.socket, stop: asyncio.Event) -> None:
        """Answer until ``stop``."""
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: PageConnection(self), sock=bound)
        self.ready()
        await stop.wait()
        server.close()
        self.end_all()
