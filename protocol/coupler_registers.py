"""Registers of the bus coupler around the process image: one table drives the plant, the suite and the page.

The class of coupler is Beckhoff's BK9000/BK9100: identification, status, image lengths and watchdog live at
fixed addresses; analog terminals map first, digital ones behind them.
"""

from typing import NamedTuple

from protocol.process_image import INPUT_WORDS, OUTPUT_ADDRESS, OUTPUT_WORDS

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

STATUS_FIELDBUS = 1 << 15

WATCHDOG_DEFAULT_MS = 1000
RESET_WORDS = (0xBECF, 0xAFFE)
TRIGGER_WRITES = 0
TRIGGER_ANY = 1

IDENTIFICATION_TEXT = "LONGREACH-9100"
DIGITAL_INPUTS = 16
DIGITAL_OUTPUTS = 16
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
