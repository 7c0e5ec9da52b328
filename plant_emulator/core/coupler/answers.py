"""The coupler's answers: each request is judged, refused with its exception or carried out on the image."""

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

from plant_emulator.core.coupler.image import COUPLER_MAP, CouplerImage
from plant_emulator.core.coupler.modbus_requests import (
    CLEAR_COUNTERS,
    COUNT_EXCEPTIONS,
    COUNT_FRAMING_ERRORS,
    DIAGNOSTICS,
    ECHO,
    FORM_BYTES,
    READ_COILS,
    READ_DISCRETE,
    READ_STATUS,
    READ_WRITE_MULTIPLE,
    WRITE_COIL,
    WRITE_COILS,
    WRITE_MULTIPLE,
    WRITE_SINGLE,
    WRITING,
    Span,
    exception_for,
    read,
    written,
)
from plant_emulator.core.coupler.watchdog import CouplerWatchdog
from protocol.coupler_registers import IDENTIFICATION
from protocol.process_image import ValveImage

_BIT_FUNCTIONS = (READ_COILS, READ_DISCRETE, WRITE_COIL, WRITE_COILS)
_WRITTEN_AT = {WRITE_SINGLE: 3, WRITE_MULTIPLE: 6, READ_WRITE_MULTIPLE: 10}  # where the words begin
_FORMS = 256  # a master repeats a few; each is judged once
_CENTRED = ValveImage(0, 0, (0.0,) * 6)


class CouplerStatistics:
    """Counts since the start: exchanges answered, exceptions returned, images refused, connections seen.

    ``displaced``, ``unread``, ``quiet``: connections that were closed to make room, because their answers
    were not read, and because they asked nothing.
    """

    def __init__(self) -> None:
        self.requests = 0
        self.exceptions = 0
        self.torn_images = 0
        self.connections = 0
        self.framing_errors = 0
        self.watchdog_expiries = 0
        self.displaced = 0
        self.unread = 0
        self.quiet = 0

    def as_dict(self) -> dict[str, int]:
        """The counts by name."""
        return dict(vars(self))


class RequestForm(NamedTuple):
    """What a request is by its first bytes and its length, whatever words it carries.

    ``code``: the exception it deserves, or 0. ``reads``, ``writes``: registers or bits, where it is sound.
    ``terminals``: whether it concerns terminals and not the coupler's own registers. ``words_read``,
    ``words_written``: their layout in response and request.
    """

    function: int
    code: int
    reads: Span | None
    writes: Span | None
    terminals: bool
    words_read: struct.Struct
    words_written: struct.Struct


class CouplerAnswers:
    """Serves the newest sensor words and hands whole valve images on; one master at a time may write.

    ``sensor_words``: called for each read of the inputs, returns INPUT_WORDS words. ``on_valves``: called
    with each whole image that a master wrote, and with a centred one when the watchdog expires.
    ``release_ns``: a master that has not written for so long loses the outputs to whoever writes next.
    ``report``: called as ``EventLog.write_repeated``, with what happens. Masters are any objects; times are
    of one monotonic clock. ``writer``: who wrote outputs last, until it has gone; expiry changes nothing.
    """

    def __init__(
        self,
        sensor_words: Callable[[], list[int]],
        on_valves: Callable[[ValveImage], None],
        release_ns: int,
        report: Callable[..., None],
    ) -> None:
        self.statistics = CouplerStatistics()
        self._watchdog = CouplerWatchdog(release_ns)
        self.writer: object | None = None
        self._on_valves = on_valves
        self._report = report
        self._image = CouplerImage(sensor_words, self._watchdog)
        self._counted_from = self.statistics.as_dict()

    def answered(self, master: object, pdu: bytes, now_ns: int) -> bytes:
        """The response PDU to a request PDU of ``master``."""
        self.statistics.requests += 1
        self.look_at_watchdog(now_ns)
        form = _form(pdu[:FORM_BYTES], len(pdu))
        code, response, wrote = form.code, b"", form.terminals and form.writes is not None
        if code == 0 and form.terminals:
            code = self._watchdog.refusal(master, wrote, now_ns)
        if code == 0 and form.writes is not None:
            code = self._write(form, form.writes, pdu, master, now_ns)
        if code == 0:
            response = self._response(form, pdu, now_ns)
            self._watchdog.obeyed(master, wrote, now_ns)
            if wrote:
                self.writer = master
            return response
        self.statistics.exceptions += 1
        return bytes((form.function | 0x80, code))

    def look_at_watchdog(self, now_ns: int) -> None:
        """Let the watchdog expire if it is due: all outputs go to zero."""
        if not self._watchdog.look(now_ns):
            return
        why = f"nothing written for {self._watchdog.time_ms} ms, outputs at zero"
        self._tell("watchdog_expiries", "watchdog_expired", "coupler.watchdog", why)
        self._image.clear_outputs()
        self._on_valves(_CENTRED)

    def gone(self, master: object) -> None:
        """A master has gone; the outputs keep their words until a watchdog acts."""
        self._watchdog.gone(master)
        if self.writer is master:
            self.writer = None

    def _tell(self, counter: str, event: str, cause: str, why: str) -> None:
        """Count under a name of the statistics, and report."""
        count = getattr(self.statistics, counter) + 1
        setattr(self.statistics, counter, count)
        self._report(cause, event, "warning", cause=cause, detail=why, count=count)

    def _write(self, form: RequestForm, span: Span, pdu: bytes, master: object, now_ns: int) -> int:
        """Carry out the writing part of a sound request; the exception that its words deserve, or 0."""
        if form.function in _BIT_FUNCTIONS:
            self._image.write_bits(span.address, _bits_of(pdu, span.words))
            return 0
        words = form.words_written.unpack_from(pdu, _WRITTEN_AT[form.function])
        if span.address >= IDENTIFICATION:
            # Each of these registers is a block of its own, so exactly one word comes.
            return self._watchdog.configure(master, span.address, words[0], now_ns)
        code, image, torn = self._image.write(span.address, words)
        self.statistics.torn_images += torn
        if image is not None:
            self._on_valves(image)
        return code

    def _response(self, form: RequestForm, pdu: bytes, now_ns: int) -> bytes:
        if form.reads is not None:
            if form.function in _BIT_FUNCTIONS:
                data = _packed(self._image.bits(form.function, *form.reads))
            else:
                data = form.words_read.pack(*self._image.words(*form.reads, now_ns))
            return bytes((form.function, len(data))) + data
        return self._diagnosed(pdu) if form.function == DIAGNOSTICS else pdu[:5]

    def _diagnosed(self, pdu: bytes) -> bytes:
        sub_function = int.from_bytes(pdu[1:3], "big")
        if sub_function in (ECHO, CLEAR_COUNTERS):
            if sub_function == CLEAR_COUNTERS:
                self._counted_from = self.statistics.as_dict()
            return pdu
        if sub_function == READ_STATUS:
            return pdu[:3] + struct.pack(">H", self._image.status())
        name = {COUNT_EXCEPTIONS: "exceptions", COUNT_FRAMING_ERRORS: "framing_errors"}.get(
            sub_function, "requests"
        )
        count = getattr(self.statistics, name) - self._counted_from[name]
        return pdu[:3] + struct.pack(">H", count & 0xFFFF)


@lru_cache(_FORMS)
def _form(head: bytes, length: int) -> RequestForm:
    pdu = head.ljust(length, b"\0")
    function, code = pdu[0], exception_for(pdu, COUPLER_MAP)
    if code != 0 or function == DIAGNOSTICS:
        return RequestForm(function & 0x7F, code, None, None, False, _words(None), _words(None))
    reads = read(pdu) if function in COUPLER_MAP.reads else None
    writes = written(pdu) if function in WRITING else None
    concerned = writes or reads
    assert concerned is not None
    terminals = function in _BIT_FUNCTIONS or concerned.address < IDENTIFICATION
    return RequestForm(function, 0, reads, writes, terminals, _words(reads), _words(writes))


def _words(span: Span | None) -> struct.Struct:
    return struct.Struct(f">{span.words if span else 0}H")


def _bits_of(pdu: bytes, count: int) -> list[bool]:
    """The bits that function code 5 or 15 writes."""
    if pdu[0] == WRITE_COIL:
        return [pdu[3] != 0]
    return [bool(pdu[6 + at // 8] >> at % 8 & 1) for at in range(count)]


def _packed(bits: Sequence[bool]) -> bytes:
    """Eight bits a byte, the first in the lowest place."""
    number = sum(1 << at for at, bit in enumerate(bits) if bit)
    return number.to_bytes((len(bits) + 7) // 8, "little")
