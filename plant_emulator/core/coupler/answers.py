"""The coupler's answers: each request is judged, refused with its exception or carried out on the image."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace

from plant_emulator.core.coupler.image import COUPLER_MAP, CouplerImage
from plant_emulator.core.coupler.modbus_requests import (
    CLEAR_COUNTERS,
    COUNT_EXCEPTIONS,
    COUNT_FRAMING_ERRORS,
    DIAGNOSTICS,
    ECHO,
    READ_COILS,
    READ_DISCRETE,
    READ_STATUS,
    WRITE_COIL,
    WRITE_COILS,
    Request,
    Span,
)
from plant_emulator.core.coupler.watchdog import CouplerWatchdog
from protocol.coupler_registers import IDENTIFICATION
from protocol.process_image import ValveImage

_BIT_FUNCTIONS = (READ_COILS, READ_DISCRETE, WRITE_COIL, WRITE_COILS)
_CENTRED = ValveImage(0, 0, (0.0,) * 6)


COUNTED = (
    "requests", "exceptions", "torn_images", "connections", "framing_errors", "watchdog_expiries",
    "displaced", "unread", "quiet",
)  # fmt: skip
"""Counts since the start: exchanges answered, exceptions returned, images refused, connections seen, frames
refused; connections that were closed to make room, because their answers were not read, because they asked
nothing.
"""


class CouplerAnswers:
    """Serves the newest sensor words and hands whole valve images on; one master at a time may write.

    ``sensor_words``: called for each read of the inputs, returns INPUT_WORDS words. ``on_valves``: called
    with each whole image that a master wrote, and with a centred one when the watchdog expires.
    ``release_ns``: a master that has not written for so long loses the outputs to whoever writes next.
    ``report``: called as ``EventLog.write_repeated``, with what happens. Masters are any objects; times are
    of one monotonic clock. ``statistics``: counts by the names in COUNTED. ``writer``: who wrote outputs
    last, until it has gone; expiry changes nothing.
    """

    def __init__(
        self,
        sensor_words: Callable[[], list[int]],
        on_valves: Callable[[ValveImage], None],
        release_ns: int,
        report: Callable[..., None],
    ) -> None:
        self.statistics = SimpleNamespace(**dict.fromkeys(COUNTED, 0))
        self._watchdog = CouplerWatchdog(release_ns)
        self.writer: object | None = None
        self._on_valves = on_valves
        self._report = report
        self._image = CouplerImage(sensor_words, self._watchdog)
        self._counted_from = dict(vars(self.statistics))

    def answered(self, master: object, request: Request, now_ns: int) -> tuple[int, Sequence[int]]:
        """Exception code of a request of ``master``, or 0 and the words or bits that it reads, if any."""
        self.statistics.requests += 1
        self.look_at_watchdog(now_ns)
        code, writes = COUPLER_MAP.exception_for(request), request.writes
        concerned = writes or request.reads
        terminals = concerned is not None and (
            request.function in _BIT_FUNCTIONS or concerned.address < IDENTIFICATION
        )
        wrote = terminals and writes is not None
        if code == 0 and terminals:
            code = self._watchdog.refusal(master, wrote, now_ns)
        if code == 0 and writes is not None:
            code = self._write(request, writes, master, now_ns)
        if code != 0:
            self.statistics.exceptions += 1
            return code, ()
        read = self._read_words(request, now_ns)
        self._watchdog.obeyed(master, wrote, now_ns)
        if wrote:
            self.writer = master
        return 0, read

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

    def _write(self, request: Request, span: Span, master: object, now_ns: int) -> int:
        """Carry out the writing part of a sound request; the exception that its values deserve, or 0."""
        if request.function in _BIT_FUNCTIONS:
            self._image.write_bits(span.address, request.values)
            return 0
        if span.address >= IDENTIFICATION:
            # Each of these registers is a block of its own, so exactly one word comes.
            return self._watchdog.configure(master, span.address, request.values[0], now_ns)
        code, image, torn = self._image.write(span.address, request.values)
        self.statistics.torn_images += torn
        if image is not None:
            self._on_valves(image)
        return code

    def _read_words(self, request: Request, now_ns: int) -> Sequence[int]:
        if request.function == DIAGNOSTICS:
            return self._diagnosed(*request.values)
        if request.reads is None:
            return ()
        if request.function in _BIT_FUNCTIONS:
            return self._image.bits(request.function, *request.reads)
        return self._image.words(*request.reads, now_ns)

    def _diagnosed(self, sub_function: int, *data: int) -> Sequence[int]:
        if sub_function in (ECHO, CLEAR_COUNTERS):
            if sub_function == CLEAR_COUNTERS:
                self._counted_from = dict(vars(self.statistics))
            return data
        if sub_function == READ_STATUS:
            return (self._image.status(),)
        name = {COUNT_EXCEPTIONS: "exceptions", COUNT_FRAMING_ERRORS: "framing_errors"}.get(
            sub_function, "requests"
        )
        return ((getattr(self.statistics, name) - self._counted_from[name]) & 0xFFFF,)
