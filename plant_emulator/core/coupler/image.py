"""The coupler's process image: what lies at which address, for words and for bits."""

from collections.abc import Callable, Sequence

from plant_emulator.core.coupler.modbus_requests import (
    ILLEGAL_VALUE,
    READ_COILS,
    READ_DISCRETE,
    READ_HOLDING,
    READ_INPUT,
    READ_WRITE_MULTIPLE,
    WRITE_COIL,
    WRITE_COILS,
    WRITE_MULTIPLE,
    WRITE_SINGLE,
    RegisterMap,
    Span,
)
from plant_emulator.core.coupler.watchdog import CouplerWatchdog
from protocol.coupler_registers import (
    ANALOG_OUTPUT_BITS,
    COUPLER_TABLE,
    DIGITAL_INPUTS,
    DIGITAL_OUTPUT_ADDRESS,
    DIGITAL_OUTPUTS,
    IDENTIFICATION,
    INPUT_IMAGE_WORDS,
    OUTPUT_IMAGE_WORDS,
    STATUS,
    STATUS_FIELDBUS,
    WATCHDOG_LEFT_MS,
    WATCHDOG_RESET,
    WATCHDOG_TIME_MS,
    WATCHDOG_TRIGGER,
    identification_words,
)
from protocol.errors import ImageRefused
from protocol.process_image import (
    INPUT_ADDRESS,
    INPUT_TABLE,
    INPUT_WORDS,
    OUTPUT_ADDRESS,
    OUTPUT_WORDS,
    ValveImage,
    decode_valves,
)

_INPUTS = Span(INPUT_ADDRESS, INPUT_IMAGE_WORDS)
_OUTPUTS = Span(OUTPUT_ADDRESS, OUTPUT_IMAGE_WORDS)
_BITS_IN, _BITS_OUT = Span(0, DIGITAL_INPUTS), Span(0, DIGITAL_OUTPUTS)
_WRITABLE_ROWS = tuple(Span(row.address, row.words) for row in COUPLER_TABLE if row.writable)
_LENGTHS = (16 * OUTPUT_WORDS, 16 * INPUT_WORDS, DIGITAL_OUTPUTS, DIGITAL_INPUTS)
_STATUS_WORD = next(row.address for row in INPUT_TABLE if row.name == "status") - INPUT_ADDRESS


def _join_spans(spans: Sequence[Span]) -> tuple[Span, ...]:
    whole = [spans[0]]
    for span in spans[1:]:
        last = whole[-1]
        if span.address == last.address + last.words:
            whole[-1] = Span(last.address, last.words + span.words)
        else:
            whole.append(span)
    return tuple(whole)


_CONFIGURATION = _join_spans([Span(row.address, row.words) for row in COUPLER_TABLE])
COUPLER_MAP = RegisterMap(
    reads={
        READ_COILS: (_BITS_OUT,),
        READ_DISCRETE: (_BITS_IN,),
        READ_HOLDING: (_INPUTS, _OUTPUTS, *_CONFIGURATION),
        READ_INPUT: (_INPUTS, *_CONFIGURATION),
        READ_WRITE_MULTIPLE: (_INPUTS, _OUTPUTS, *_CONFIGURATION),
    },
    writes={
        WRITE_COIL: (_BITS_OUT,),
        WRITE_SINGLE: (_OUTPUTS, *_WRITABLE_ROWS),
        WRITE_COILS: (_BITS_OUT,),
        WRITE_MULTIPLE: (_OUTPUTS, *_WRITABLE_ROWS),
        READ_WRITE_MULTIPLE: (_OUTPUTS,),
    },
)


class CouplerImage:
    """Inputs, outputs and the coupler's own registers, by address.

    ``sensor_words``: called for each read of the inputs, returns INPUT_WORDS words. Addresses and counts
    are those of sound requests (COUPLER_MAP).
    """

    def __init__(self, sensor_words: Callable[[], list[int]], watchdog: CouplerWatchdog) -> None:
        self._sensor_words = sensor_words
        self._watchdog = watchdog
        self._outputs = [0] * OUTPUT_IMAGE_WORDS

    def clear_outputs(self) -> None:
        """All outputs go to zero."""
        self._outputs = [0] * OUTPUT_IMAGE_WORDS

    def words(self, address: int, count: int, now_ns: int) -> list[int]:
        """``count`` registers from ``address`` on."""
        if address < OUTPUT_ADDRESS:
            words = self._sensor_words()
            begin, end = address - INPUT_ADDRESS, address - INPUT_ADDRESS + count
            if end > INPUT_WORDS:
                words = [*words, words[_STATUS_WORD]]  # the digital inputs lie behind the analog ones
            return words[begin:end]
        if address < IDENTIFICATION:
            return self._outputs[address - OUTPUT_ADDRESS :][:count]
        return [self._own_register(at, now_ns) for at in range(address, address + count)]

    def bits(self, function: int, address: int, count: int) -> list[bool]:
        """``count`` digital inputs (function code 2) or outputs."""
        word = self._sensor_words()[_STATUS_WORD] if function == READ_DISCRETE else self._outputs[-1]
        return [bool(word >> at & 1) for at in range(address, address + count)]

    def write_bits(self, address: int, bits: Sequence[int]) -> None:
        """Sets digital outputs."""
        word = self._outputs[-1]
        for at, bit in enumerate(bits, address):
            word = word | 1 << at if bit else word & ~(1 << at)
        self._outputs[-1] = word

    def write(self, address: int, words: Sequence[int]) -> tuple[int, ValveImage | None, bool]:
        """Exception code of a write to the outputs, the whole image that it completes, whether it is torn.

        A write that holds an impossible command is refused whole with ILLEGAL_VALUE.
        """
        outputs = list(self._outputs)
        start = address - OUTPUT_ADDRESS
        outputs[start : start + len(words)] = words
        if address >= DIGITAL_OUTPUT_ADDRESS:
            self._outputs = outputs
            return 0, None, False
        try:
            image = decode_valves(outputs[:OUTPUT_WORDS])
        except ImageRefused as refusal:
            if refusal.cause != "image.torn":
                return ILLEGAL_VALUE, None, False
            self._outputs = outputs
            return 0, None, True
        self._outputs = outputs
        return 0, image, False

    def status(self) -> int:
        """The coupler's status word."""
        return STATUS_FIELDBUS if self._watchdog.expired else 0

    def _own_register(self, address: int, now_ns: int) -> int:
        watchdog = self._watchdog
        if address < STATUS:
            return identification_words()[address - IDENTIFICATION]
        if ANALOG_OUTPUT_BITS <= address < ANALOG_OUTPUT_BITS + len(_LENGTHS):
            return _LENGTHS[address - ANALOG_OUTPUT_BITS]
        return {
            STATUS: self.status(),
            WATCHDOG_LEFT_MS: watchdog.left_ms(now_ns),
            WATCHDOG_TIME_MS: watchdog.time_ms,
            WATCHDOG_RESET: watchdog.reset_word,
            WATCHDOG_TRIGGER: watchdog.trigger,
        }[address]
