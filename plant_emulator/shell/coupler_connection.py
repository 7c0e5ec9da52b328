"""One master's TCP connection to the coupler: requests in, answers out, order kept, nothing piled up."""

import asyncio
import socket
import struct
from collections.abc import Callable, Sequence
from typing import Protocol, cast

from pymodbus.pdu import DecodePDU, ExceptionResponse
from pymodbus.pdu.diag_message import DiagnosticBase
from pymodbus.pdu.register_message import ReadWriteMultipleRegistersRequest

from foundation.modbus import PlaceLost, StreamFramer, decoded, encoded
from plant_emulator.core.coupler import modbus_requests as modbus
from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.core.coupler.modbus_requests import Request, Span

MAX_WRITE_BITS = 1968  # pymodbus takes 2000, as for reading; of words a frame holds no more than 123
_HEAD_BYTES = 6  # of a write: function code, address, quantity or value, byte count
_SERVED = {*COUPLER_MAP.reads, *COUPLER_MAP.writes, modbus.DIAGNOSTICS}
_DECODER = DecodePDU(is_server=True)


def request_of(data: bytes) -> Request:
    """What a request PDU (not empty) asks; its ``code`` where function, quantities or lengths are refused."""
    function = data[0]
    sub_function = int.from_bytes(data[1:3], "big") if function == modbus.DIAGNOSTICS and data[2:] else 0
    if function not in _SERVED or sub_function not in modbus.SUB_FUNCTIONS:
        return Request(function, modbus.ILLEGAL_FUNCTION)
    asked = decoded(_DECODER, data)
    if isinstance(asked, ReadWriteMultipleRegistersRequest):
        if asked.write_byte_count == 2 * asked.write_count <= 2 * asked.MAX_WRITE_COUNT:
            reads = Span(asked.read_address, asked.read_count)
            writes = Span(asked.write_address, asked.write_count)
            return Request(function, 0, reads, writes, asked.write_registers)
    elif isinstance(asked, DiagnosticBase):
        if encoded(asked) == data and (words := _data_of(asked)):
            return Request(function, values=(sub_function, *words))
    elif asked is not None and function in COUPLER_MAP.reads:
        return Request(function, 0, Span(asked.address, asked.count))
    elif asked is not None:
        values = asked.bits or asked.registers
        counted = 1 <= len(values) <= MAX_WRITE_BITS and asked.count in (0, len(values))
        if counted and encoded(asked)[:_HEAD_BYTES] == data[:_HEAD_BYTES]:
            return Request(function, 0, None, Span(asked.address, len(values)), values)
    return Request(function, modbus.ILLEGAL_VALUE)


def answer_to(request: Request, code: int, read: Sequence[int]) -> bytes:
    """The response PDU: the exception ``code``, or with 0 what was read or that all was written."""
    if code:
        return encoded(ExceptionResponse(request.function, code))
    if request.function == modbus.DIAGNOSTICS:
        answer = DiagnosticBase(list(read))
        answer.sub_function_code = request.values[0]
        return encoded(answer)
    address, count = request.writes or (0, 0)
    words = read or request.values
    bits = cast(Sequence[bool], words)  # the same, of the function codes that have them
    kind = DecodePDU.pdu_table[request.function][1]
    return encoded(kind(address=address, count=count, bits=bits, registers=words))


def _data_of(asked: DiagnosticBase) -> tuple[int, ...]:
    data = asked.message
    if isinstance(data, bytes) and len(data) % 2 == 0:  # the echo
        return struct.unpack(f">{len(data) // 2}H", data)
    return (0,) if data == 0 else ()


SLICE = 16  # requests that one step of the loop serves
_RECEIVE_BYTES = 4096
_FRAMER = StreamFramer(DecodePDU(is_server=True))


class Answers(Protocol):
    """The coupler as its connections see it."""

    silent: Callable[[], bool]
    clock_ns: Callable[[], int]

    def answer(self, master: object, unit: int, pdu: bytes) -> bytes:
        """The response PDU to a request PDU."""
        ...

    def comes_first(self, connection: "CouplerConnection") -> bool:
        """Whether this connection is served at once; others wait for their turn."""
        ...

    def wait_for_turn(self, connection: "CouplerConnection") -> None:
        """Have ``serve`` called in a later step of the loop."""
        ...

    def read_for(self, connection: "CouplerConnection", cost_ns: int) -> None:
        """Note what it took to read what a master sent."""
        ...

    def lost_its_place(self, why: str) -> None:
        """Count a frame header that made no sense."""
        ...

    def disconnected(self, connection: "CouplerConnection") -> None:
        """A master has gone."""
        ...


class CouplerConnection:
    """Serves slices of requests; reads on only when all of them are served and their answers are sent.

    So a master that pipelines without reading fills the buffers of its own socket and no memory of ours.
    A silent coupler swallows whole requests. ``blocked_ns``: since when answers wait to be read, or None.
    """

    def __init__(self, coupler: Answers, sock: socket.socket, address: str) -> None:
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
        answers, count, silent = [], 0, self._coupler.silent()
        try:
            while count < most:
                used, unit, transaction, pdu = _FRAMER.decode(self._held)
                if not used:
                    break
                self._held = self._held[used:]
                count += 1
                if not silent:
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
        began_ns = self._coupler.clock_ns()
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
        if self._coupler.comes_first(self):
            self.serve(SLICE)
        else:
            self._wait()
            self._coupler.read_for(self, self._coupler.clock_ns() - began_ns)

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
