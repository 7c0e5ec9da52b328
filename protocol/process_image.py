"""The fieldbus process image: one table of registers drives the codec both ways and the documentation.

32-bit values are two words, low word first (the coupler's "Intel format"). The cycle counter opens and closes
each image, so an image that was read or written in pieces is recognised as torn.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from protocol.errors import ImageRefused, RequestRefused


class SensorImage(NamedTuple):
    """Plant → controller, in the fieldbus's own units (raw counts and scaled integers already decoded to SI).

    ``encoder_counts``: six signed counts, ``2**17`` to the turn, slew lift tilt wrist1 wrist2 wrist3.
    ``pressures_bar``: per actuator chamber a, chamber b (gauge-free, absolute).
    """

    plant_cycle: int
    echo_cycle: int
    status: int
    encoder_counts: tuple[int, int, int, int, int, int]
    pressures_bar: tuple[tuple[float, float], ...]
    supply_bar: float
    return_bar: float
    oil_temperature_degc: float


class ValveImage(NamedTuple):
    """Controller → plant. ``valves`` are spool commands in −1…1, positive raises the joint angle."""

    controller_cycle: int
    control: int
    valves: tuple[float, float, float, float, float, float]


# bits of SensorImage.status
STATUS_SUPPLY_ON = 1 << 0
STATUS_VALVES_ENABLED = 1 << 1
STATUS_WATCHDOG_TRIPPED = 1 << 2
STATUS_SENSOR_FAULT = 1 << 3

# bits of ValveImage.control
CONTROL_ENABLE = 1 << 0
CONTROL_RESET_WATCHDOG = 1 << 1

COUNTS_PER_TURN = 1 << 17
VALVE_FULL_SCALE = 32767
CYCLE_MODULUS = 1 << 16
INPUT_LAYOUT = 0x4C01

INPUT_ADDRESS = 0x0000
OUTPUT_ADDRESS = 0x0800
INPUT_WORDS = 40
OUTPUT_WORDS = 12


@dataclass(frozen=True, slots=True)
class Register:
    """One row of a table: ``count`` values of struct type ``code`` from ``address`` on.

    value = raw / ``scale``. ``low``…``high`` bound the raw value. ``saturates``: a value beyond them is sent
    as the bound, as a transmitter does; else it is refused. ``constant`` is a fixed raw value; a ``reserved``
    row is sent as zero and ignored. A ``counter`` is taken modulo 2^16. ``closes`` repeats the first word.
    """

    address: int
    name: str
    code: str
    count: int
    unit: str
    meaning: str
    scale: float = 1.0
    low: int = 0
    high: int = 0xFFFF
    saturates: bool = False
    counter: bool = False
    constant: int | None = None
    reserved: bool = False
    closes: bool = False

    @property
    def words(self) -> int:
        """Registers that the row occupies."""
        return self.count * (2 if self.code == "i" else 1)


_JOINTS = "slew, lift, tilt, wrist 1, wrist 2, wrist 3"

# fmt: off - one row a register reads as the table that it is
INPUT_TABLE = (
    Register(0x0000, "plant_cycle", "H", 1, "", "plant cycle, modulo 2^16", counter=True),
    Register(0x0001, "layout", "H", 1, "", "which table this image follows", constant=INPUT_LAYOUT),
    Register(0x0002, "echo_cycle", "H", 1, "", "controller_cycle last received", counter=True),
    Register(0x0003, "status", "H", 1, "bits", "see the table of status bits"),
    Register(0x0004, "encoder_counts", "i", 6, "1/131072 turn", _JOINTS, low=-(2**31), high=2**31 - 1),
    Register(0x0010, "pressures_bar", "H", 12, "bar", f"absolute; a, b of {_JOINTS}", 100.0, saturates=True),
    Register(0x001C, "supply_bar", "H", 1, "bar", "supply pressure, absolute", 100.0, saturates=True),
    Register(0x001D, "return_bar", "H", 1, "bar", "return pressure, absolute", 100.0, saturates=True),
    Register(0x001E, "oil_temperature_degc", "h", 1, "°C", "oil", 100.0, -(2**15), 2**15 - 1, saturates=True),
    Register(0x001F, "reserved", "H", 8, "", "zero; ignored on receipt", reserved=True),
    Register(0x0027, "plant_cycle_again", "H", 1, "", "equals plant_cycle, or torn", closes=True),
)

OUTPUT_TABLE = (
    Register(0x0800, "controller_cycle", "H", 1, "", "controller cycle, modulo 2^16", counter=True),
    Register(0x0801, "control", "H", 1, "bits", "see the table of control bits"),
    Register(
        0x0802, "valves", "h", 6, "1", f"spools of {_JOINTS}", 32767.0, -VALVE_FULL_SCALE, VALVE_FULL_SCALE
    ),
    Register(0x0808, "reserved", "H", 3, "", "zero; ignored on receipt", reserved=True),
    Register(0x080B, "controller_cycle_again", "H", 1, "", "equals controller_cycle, or torn", closes=True),
)
# fmt: on


_Field = tuple[Register, int, int, bool]
_RANGES = {"H": (0, 2**16 - 1), "h": (-(2**15), 2**15 - 1), "i": (-(2**31), 2**31 - 1)}  # of struct's codes


def _layout(table: tuple[Register, ...]) -> struct.Struct:
    return struct.Struct("<" + "".join(f"{row.count}{row.code}" for row in table))


_ECHO_CYCLE, _STATUS = (
    next(row.address - INPUT_ADDRESS for row in INPUT_TABLE if row.name == name)
    for name in ("echo_cycle", "status")
)


def _fields(table: tuple[Register, ...]) -> list[_Field]:
    """The rows that say something, each with its place among the numbers and whether a number can be off."""
    fields: list[_Field] = []
    begin = 0
    for row in table:
        end = begin + row.count
        if not (row.reserved or row.closes):
            fields.append((row, begin, end, (row.low, row.high) != _RANGES[row.code]))
        begin = end
    return fields


_INPUT_FIELDS, _OUTPUT_FIELDS = _fields(INPUT_TABLE), _fields(OUTPUT_TABLE)
_INPUT_LAYOUT = _layout(INPUT_TABLE)
_OUTPUT_LAYOUT = _layout(OUTPUT_TABLE)
_INPUT_WORDS = struct.Struct(f"<{INPUT_WORDS}H")
_OUTPUT_WORDS = struct.Struct(f"<{OUTPUT_WORDS}H")


def encode_sensors(image: SensorImage) -> list[int]:
    """The INPUT_WORDS words of ``image``, to be served from INPUT_ADDRESS on.

    Analog values saturate at the ends of their register. Raises RequestRefused for NaN, infinity, or counts
    beyond 32 bits.
    """
    values = image._asdict()
    values["pressures_bar"] = [pressure for pair in image.pressures_bar for pressure in pair]
    return list(_INPUT_WORDS.unpack(_INPUT_LAYOUT.pack(*_raw_values(values, INPUT_TABLE))))


def acknowledge(words: list[int], echo_cycle: int, status: int) -> None:
    """Bring the encoded sensors ``words`` up to a valve image that came since they were measured."""
    words[_ECHO_CYCLE] = echo_cycle % CYCLE_MODULUS
    words[_STATUS] = status


def decode_sensors(words: Sequence[int]) -> SensorImage:
    """The image in INPUT_WORDS words read from INPUT_ADDRESS on.

    Raises ImageRefused: wrong count (``image.bad_length``), not words at all (``image.not_words``), written
    after another table (``image.layout``), torn (``image.torn``).
    """
    values = _decoded(words, _INPUT_FIELDS, _INPUT_WORDS, _INPUT_LAYOUT)
    pressures = values["pressures_bar"]
    values["pressures_bar"] = tuple(zip(pressures[0::2], pressures[1::2], strict=True))
    return SensorImage(**values)


def encode_valves(image: ValveImage) -> list[int]:
    """The OUTPUT_WORDS words of ``image``, to be written from OUTPUT_ADDRESS on.

    Raises RequestRefused for NaN, infinity or a spool command beyond −1…1.
    """
    return list(_OUTPUT_WORDS.unpack(_OUTPUT_LAYOUT.pack(*_raw_values(image._asdict(), OUTPUT_TABLE))))


def decode_valves(words: Sequence[int]) -> ValveImage:
    """The image in OUTPUT_WORDS words written from OUTPUT_ADDRESS on; all zero: disabled, valves centred.

    Raises ImageRefused: wrong count (``image.bad_length``), not words at all (``image.not_words``), a spool
    command of −32768 (``image.out_of_range``), which is found in a torn image too, torn (``image.torn``).
    """
    return ValveImage(**_decoded(words, _OUTPUT_FIELDS, _OUTPUT_WORDS, _OUTPUT_LAYOUT))


def _raw_values(values: dict[str, Any], table: tuple[Register, ...]) -> list[int]:
    raw: list[int] = []
    for row in table:
        if row.reserved:
            raw += (0,) * row.count
        elif row.closes:
            raw.append(raw[0])
        elif row.constant is not None:
            raw.append(row.constant)
        elif row.counter:
            raw.append(values[row.name] % CYCLE_MODULUS)
        elif row.count == 1:
            raw += _scaled((values[row.name],), row)
        else:
            raw += _scaled(values[row.name], row)
    return raw


def _scaled(numbers: Sequence[float], row: Register) -> list[int]:
    if len(numbers) != row.count:
        raise RequestRefused(
            "refused.not_encodable", f"{row.name}: {len(numbers)} values, wanted {row.count}"
        )
    try:
        raw = [round(value * row.scale) for value in numbers]
    except (ValueError, OverflowError):  # not a finite number: found below
        raw = []
    if raw and row.low <= min(raw) and max(raw) <= row.high:
        return raw
    return [_raw(value, row) for value in numbers]


def _raw(value: float, row: Register) -> int:
    if not math.isfinite(value):
        raise RequestRefused("refused.not_encodable", f"{row.name} = {value}: not a finite number")
    raw = round(value * row.scale)
    if row.low <= raw <= row.high:
        return raw
    if row.saturates:
        return min(max(raw, row.low), row.high)
    raise RequestRefused(
        "refused.not_encodable",
        f"{row.name} = {value}: wanted {row.low / row.scale:g}…{row.high / row.scale:g}",
    )


def _decoded(
    words: Sequence[int], fields: list[_Field], words_layout: struct.Struct, layout: struct.Struct
) -> dict[str, Any]:
    if len(words) * 2 != layout.size:
        raise ImageRefused("image.bad_length", f"{len(words)} words: the image has {layout.size // 2}")
    try:
        numbers = layout.unpack(words_layout.pack(*words))
    except struct.error as error:
        raise ImageRefused("image.not_words", f"not 16-bit words: {error}") from error
    values: dict[str, Any] = {}
    for row, begin, end, checked in fields:
        raw = numbers[begin:end]
        if row.constant is not None:
            if raw[0] != row.constant:
                raise ImageRefused("image.layout", f"layout word {raw[0]:#06x}: wanted {row.constant:#06x}")
            continue
        if checked and (row.low > min(raw) or max(raw) > row.high):
            number = min(raw) if min(raw) < row.low else max(raw)
            raise ImageRefused("image.out_of_range", f"{row.name} = {number}: wanted {row.low}…{row.high}")
        scale = row.scale
        scaled = raw if scale == 1.0 else tuple([number / scale for number in raw])
        values[row.name] = scaled[0] if end - begin == 1 else scaled
    # Last: an impossible value is one in a torn image too, and is refused when it comes, not when it acts.
    if numbers[0] != numbers[-1]:
        raise ImageRefused("image.torn", f"cycle {numbers[0]} at the start, {numbers[-1]} at the end")
    return values
