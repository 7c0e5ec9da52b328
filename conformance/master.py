"""The tester's side of Modbus TCP: raw requests out, answers in, every byte of them on the record."""

import select
import socket
import struct
import time
from typing import NamedTuple

from conformance.wire import MS, Failed, Line, NoAnswer, Unsupported, require
from protocol.coupler_registers import (
    ANALOG_OUTPUT_BITS,
    RESET_WORDS,
    STATUS,
    STATUS_FIELDBUS,
    WATCHDOG_DEFAULT_MS,
    WATCHDOG_RESET,
    WATCHDOG_TIME_MS,
    WATCHDOG_TRIGGER,
)

ANSWER_MS = 1000
INPUTS, OUTPUTS = 0x0000, 0x0800
READ_HOLDING, WRITE_REGISTER, WRITE_REGISTERS = 3, 6, 16
OWNED = 6
_MBAP = struct.Struct(">HHHB")


class Lengths(NamedTuple):
    """What the coupler says of its image: words of analog terminals, bits of digital ones."""

    analog_outputs: int
    analog_inputs: int
    digital_outputs: int
    digital_inputs: int


def write_request(address: int, words: list[int]) -> bytes:
    """A request of function code 16."""
    return struct.pack(f">BHHB{len(words)}H", WRITE_REGISTERS, address, len(words), 2 * len(words), *words)


def word_request(address: int, word: int, function: int = WRITE_REGISTER) -> bytes:
    """A request of function code 6; of 1 to 4 ``word`` is the quantity."""
    return struct.pack(">BHH", function, address, word)


class Master:
    """One TCP connection to the coupler under test, that can misbehave."""

    def __init__(self, host: str, port: int, unit: int, *, outputs: bool,
                 record: list[Line] | None = None, begin_ns: int = 0) -> None:  # fmt: skip
        self.address = (host, port)
        self.unit = unit
        self.transcript: list[Line] = [] if record is None else record
        self._begin_ns = begin_ns or time.monotonic_ns()
        self._outputs_allowed = outputs
        self._touched = False
        self._transaction = 0
        self._others: list[Master] = []
        self._socket = socket.create_connection(self.address, timeout=ANSWER_MS / 1e3)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def second(self) -> "Master":
        """Another connection, sharing the transcript."""
        other = Master(*self.address, self.unit, outputs=self._outputs_allowed,
                       record=self.transcript, begin_ns=self._begin_ns)  # fmt: skip
        self._others.append(other)
        return other

    def hang_up(self) -> None:
        """Closes this connection."""
        self._socket.close()

    def close(self) -> None:
        """Leaves the coupler as a fresh one, if a case touched it, and closes every connection."""
        for each in (*self._others, self):
            each.hang_up()
        if self._touched:
            last = self.second()
            try:
                last.make_fresh()
            finally:
                last.hang_up()

    # frames

    def send_raw(self, data: bytes) -> None:
        """Sends these bytes as they are."""
        self._note("send", data)
        self._socket.sendall(data)

    def frame(self, pdu: bytes, *, transaction: int | None = None, unit: int | None = None) -> bytes:
        """A request in its frame; with ``transaction`` None it takes the next number."""
        if transaction is None:
            self._transaction = transaction = (self._transaction + 1) % 0x10000
        return _MBAP.pack(transaction, 0, len(pdu) + 1, self.unit if unit is None else unit) + pdu

    def receive(self, wait_ms: float = ANSWER_MS) -> tuple[int, int, bytes] | None:
        """Transaction, unit and PDU of the next answer; None when nothing or the end of the stream comes."""
        until_ns = time.monotonic_ns() + int(wait_ms * MS)
        head = self._exactly(_MBAP.size, until_ns)
        if head is None:
            return None
        transaction, protocol, length, unit = _MBAP.unpack(head)
        require(protocol == 0, f"an answer of protocol {protocol} came")
        require(3 <= length <= 254, f"an answer of length {length} came")
        pdu = self._exactly(length - 1, until_ns)
        if pdu is None:
            raise Failed(f"an answer of length {length} ended early")
        self._note("receive", head + pdu)
        return transaction, unit, pdu

    def is_closed(self, wait_ms: float = ANSWER_MS) -> bool:
        """Whether the coupler ends the connection within ``wait_ms`` and sends nothing before."""
        if not select.select([self._socket], [], [], wait_ms / 1e3)[0]:
            return False
        try:
            return self._socket.recv(1) == b""
        except ConnectionResetError:
            return True

    def _exactly(self, count: int, until_ns: int) -> bytes | None:
        data = b""
        while len(data) < count:
            left_s = (until_ns - time.monotonic_ns()) / 1e9
            if not select.select([self._socket], [], [], max(left_s, 0.0))[0]:
                return None
            piece = self._socket.recv(count - len(data))
            if not piece:
                return None
            data += piece
        return data

    # requests

    def ask(self, pdu: bytes, *, unit: int | None = None, transaction: int | None = None) -> bytes:
        """The answer's PDU; raises Failed unless it repeats transaction and unit."""
        frame = self.frame(pdu, transaction=transaction, unit=unit)
        self.send_raw(frame)
        answer = self.receive()
        if answer is None:
            raise NoAnswer(f"function code {pdu[0]} was not answered within {ANSWER_MS} ms")
        sent = _MBAP.unpack_from(frame)
        require(answer[0] == sent[0], f"transaction {sent[0]} was answered as {answer[0]}")
        require(answer[1] == sent[3], f"unit {sent[3]} was answered as {answer[1]}")
        return answer[2]

    def done(self, pdu: bytes, what: str) -> bytes:
        """The answer's PDU; raises Failed when it is an exception."""
        answer = self.ask(pdu)
        require(answer[0] == pdu[0], f"{what}: answered {answer.hex()}")
        return answer

    def words(self, address: int, count: int, function: int = READ_HOLDING) -> list[int]:
        """Registers; raises Failed unless exactly as many come."""
        answer = self.done(word_request(address, count, function), f"reading {count} at {address:#06x}")
        require(
            len(answer) == 2 + 2 * count and answer[1] == 2 * count, f"{count} words came as {answer.hex()}"
        )
        return list(struct.unpack(f">{count}H", answer[2:]))

    def word(self, address: int) -> int:
        """One register."""
        return self.words(address, 1)[0]

    def lengths(self) -> Lengths:
        """The lengths of the process image."""
        analog_out, analog_in, digital_out, digital_in = self.words(ANALOG_OUTPUT_BITS, 4)
        return Lengths(analog_out // 16, analog_in // 16, digital_out, digital_in)

    # the watchdog

    @property
    def expired(self) -> bool:
        """Whether the coupler's status tells of a fieldbus error."""
        return bool(self.word(STATUS) & STATUS_FIELDBUS)

    def reset(self) -> None:
        """The two words; raises Failed when one is refused."""
        for word in RESET_WORDS:
            self.done(word_request(WATCHDOG_RESET, word), f"reset word {word:#06x}")

    def make_fresh(self, watchdog_ms: int = WATCHDOG_DEFAULT_MS, trigger: int = 1) -> None:
        """Watchdog inactive, outputs zero, times as at start or as given."""
        self.reset()
        lengths = self.lengths()
        words = lengths.analog_outputs + (lengths.digital_outputs + 15) // 16
        self.done(write_request(OUTPUTS, [0] * words), "zeroing the outputs")
        self.reset()
        self.done(word_request(WATCHDOG_TIME_MS, watchdog_ms), "setting the watchdog's time")
        self.done(word_request(WATCHDOG_TRIGGER, trigger), "setting the watchdog's trigger")

    def owned_by_another(self, trigger: int = 1) -> bool:
        """Whether writing ``trigger``, which moves nothing, is refused because of the outputs' owner."""
        return self.ask(word_request(WATCHDOG_TRIGGER, trigger))[1:] == bytes([OWNED])

    def take_outputs(self, watchdog_ms: int = WATCHDOG_DEFAULT_MS, trigger: int = 1) -> Lengths:
        """The lengths, after making the coupler fresh to be written. Raises Unsupported if it may not."""
        if not self._outputs_allowed:
            raise Unsupported("writes outputs: not allowed in this run")
        if self.owned_by_another(trigger):
            raise Unsupported("another master owns the outputs")
        self._touched = True
        self.make_fresh(watchdog_ms, trigger)
        return self.lengths()

    def _note(self, direction: str, data: bytes) -> None:
        self.transcript.append(Line((time.monotonic_ns() - self._begin_ns) / MS, direction, data))
