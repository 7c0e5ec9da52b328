"""Registers of the bus coupler around the process image: one table drives the plant, the suite and the page.

The class of coupler is Beckhoff's BK9000/BK9100: identification, status, image lengths and watchdog live at
fixed addresses; analog terminals map first, digital ones behind them. And the Modbus TCP frames in which
either end carries what it asks or answers about them: cut out of a stream of bytes, and put together.
"""

import struct
from typing import NamedTuple

from protocol.process_image import INPUT_ADDRESS, INPUT_WORDS, OUTPUT_ADDRESS, OUTPUT_WORDS

IDENTIFICATION = 0x1000
STATUS = 0x100C
ANALOG_OUTPUT_BITS = 0x1010
ANALOG_INPUT_BITS = 0x1011
DIGITAL_OUTPUT_BITS = 0x1012
DIGITAL_INPUT_BITS = 0x1013
WATCHDOG_LEFT_MS = 0x1020
WATCHDOG_TIME_MS = 0x1120
WATCHDOG_RESET = 0x1121
WATCHDOG_TRIGGER = 0x1122

STATUS_TERMINAL_BUS = 1 << 0
STATUS_CONFIGURATION = 1 << 1
STATUS_FIELDBUS = 1 << 15

WATCHDOG_DEFAULT_MS = 1000
RESET_WORDS = (0xBECF, 0xAFFE)
TRIGGER_WRITES = 0
TRIGGER_ANY = 1

IDENTIFICATION_TEXT = "LONGREACH-9100"
DIGITAL_INPUTS = 16
DIGITAL_OUTPUTS = 16
DIGITAL_INPUT_ADDRESS = INPUT_ADDRESS + INPUT_WORDS
DIGITAL_OUTPUT_ADDRESS = OUTPUT_ADDRESS + OUTPUT_WORDS
INPUT_IMAGE_WORDS = INPUT_WORDS + DIGITAL_INPUTS // 16
OUTPUT_IMAGE_WORDS = OUTPUT_WORDS + DIGITAL_OUTPUTS // 16


class CouplerRegister(NamedTuple):
    """``words`` registers from ``address`` on; ``writable`` with function codes 6 and 16."""

    address: int
    words: int
    writable: bool
    name: str
    unit: str
    meaning: str


# fmt: off - one row a register reads as the table that it is
COUPLER_TABLE = (
    CouplerRegister(IDENTIFICATION, 7, False, "identification", "", "14 characters, low byte first"),
    CouplerRegister(STATUS, 1, False, "status", "bits", "see the table of coupler status bits"),
    CouplerRegister(ANALOG_OUTPUT_BITS, 1, False, "analog_output_bits", "bit", "their length"),
    CouplerRegister(ANALOG_INPUT_BITS, 1, False, "analog_input_bits", "bit", "their length"),
    CouplerRegister(DIGITAL_OUTPUT_BITS, 1, False, "digital_output_bits", "bit", "their length"),
    CouplerRegister(DIGITAL_INPUT_BITS, 1, False, "digital_input_bits", "bit", "their length"),
    CouplerRegister(WATCHDOG_LEFT_MS, 1, False, "watchdog_left_ms", "ms", "counts down to 0; inactive: 0"),
    CouplerRegister(WATCHDOG_TIME_MS, 1, True, "watchdog_time_ms", "ms", "1000 at start; 0: no watchdog"),
    CouplerRegister(WATCHDOG_RESET, 1, True, "watchdog_reset", "", "0xBECF, then 0xAFFE; reads the last"),
    CouplerRegister(WATCHDOG_TRIGGER, 1, True, "watchdog_trigger", "", "1: any telegram; 0: writes only"),
)
# fmt: on


def identification_words() -> tuple[int, ...]:
    """The seven words of IDENTIFICATION_TEXT, the first character of each pair in the low byte."""
    text = IDENTIFICATION_TEXT.encode("ascii")
    return tuple(text[i] | text[i + 1] << 8 for i in range(0, len(text), 2))


MAX_PDU_BYTES = 253
_MBAP = struct.Struct(">HHHB")
_BEFORE_LENGTH = 6  # the length counts what follows it, the unit id first


class ModbusFrame(NamedTuple):
    """A transaction number, a unit id, and the PDU of a request or of its response."""

    transaction: int
    unit: int
    pdu: bytes


class PlaceLost(Exception):
    """A frame header makes no sense, so the place in the stream is lost."""

    def __init__(self, header: bytes) -> None:
        super().__init__(f"frame header {header.hex()} refused")


class ModbusStream:
    """Holds what has come and is not yet a whole frame, or not yet taken."""

    def __init__(self) -> None:
        self._data = b""
        self._at = 0

    def __len__(self) -> int:
        """Bytes held."""
        return len(self._data) - self._at

    def add(self, data: bytes) -> None:
        """Append what the socket gave."""
        self._data = self._data[self._at :] + data
        self._at = 0

    def next(self) -> ModbusFrame | None:
        """The oldest whole frame, which is taken; None when none is whole. Raises PlaceLost."""
        data, at = self._data, self._at
        if len(data) - at < _MBAP.size:
            return None
        transaction, protocol, length, unit = _MBAP.unpack_from(data, at)
        if protocol != 0 or not 2 <= length <= MAX_PDU_BYTES + 1:
            raise PlaceLost(data[at : at + _MBAP.size])
        end = at + _BEFORE_LENGTH + length
        if len(data) < end:
            return None
        self._at = end
        return ModbusFrame(transaction, unit, data[at + _MBAP.size : end])


def framed(transaction: int, unit: int, pdu: bytes) -> bytes:
    """The frame that carries ``pdu``."""
    return _MBAP.pack(transaction, 0, len(pdu) + 1, unit) + pdu
