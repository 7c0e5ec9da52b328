"""The fieldbus process image: one table of registers drives the codec both ways and the documentation.

32-bit values are two words, low word first (the coupler's "Intel format"). The cycle counter opens and closes
each image, so an image that was read or written in pieces is recognised as torn.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import mul
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


_RANGES = {"H": (0, 2**16 - 1), "h": (-(2**15), 2**15 - 1), "i": (-(2**31), 2**31 - 1)}  # of struct's codes


class _Codec:
    """What encoding and decoding need of a table, taken apart once: both are done in every cycle.

    An image's numbers are what its layout packs, none of them reserved; ``values_of`` are made of its values.
    """

    def __init__(self, table: tuple[Register, ...]) -> None:
        packed = [row for row in table if not row.reserved]
        self.rows = tuple(row for row in packed if row.constant is None and not row.closes)
        self.layout = struct.Struct("<" + "".join(map(_code, table)))
        self.words = struct.Struct(f"<{sum(row.words for row in table)}H")
        self.values_of = tuple(row for row in self.rows for _ in range(row.count))
        self.scales = tuple(row.scale for row in self.values_of)
        self.counters = tuple(place for place, row in enumerate(self.values_of) if row.counter)
        ends = list(accumulate(row.count for row in packed))
        places = [(row, end - row.count, end) for row, end in zip(packed, ends, strict=True)]
        self.constants = tuple((k, row.constant) for row, k, _ in places if row.constant is not None)
        self.places = tuple((k, end, row.scale) for row, k, end in places if row in self.rows)
        bounded = [one for one in places if one[0] in self.rows]
        self.bounded = tuple(one for one in bounded if (one[0].low, one[0].high) != _RANGES[one[0].code])


def _code(row: Register) -> str:
    """The row in struct's letters; what is reserved is packed as zeros and not unpacked."""
    return f"{2 * row.words}x" if row.reserved else f"{row.count}{row.code}"


_INPUT, _OUTPUT = _Codec(INPUT_TABLE), _Codec(OUTPUT_TABLE)
_ECHO_CYCLE, _STATUS = (
    next(row.address - INPUT_ADDRESS for row in INPUT_TABLE if row.name == name)
    for name in ("echo_cycle", "status")
)


def encode_sensors(image: SensorImage) -> list[int]:
    """The INPUT_WORDS words of ``image``, to be served from INPUT_ADDRESS on.

    Analog values saturate at the ends of their register. Raises RequestRefused for NaN, infinity, or counts
    beyond 32 bits.
    """
    pressures = [pressure for pair in image.pressures_bar for pressure in pair]
    return _encode(image._replace(pressures_bar=pressures), _INPUT)  # type: ignore[arg-type]


def acknowledge(words: list[int], echo_cycle: int, status: int) -> None:
    """Bring the encoded sensors ``words`` up to a valve image that came since they were measured."""
    words[_ECHO_CYCLE] = echo_cycle % CYCLE_MODULUS
    words[_STATUS] = status


def decode_sensors(words: Sequence[int]) -> SensorImage:
    """The image in INPUT_WORDS words read from INPUT_ADDRESS on.

    Raises ImageRefused: wrong count (``image.bad_length``), not words at all (``image.not_words``), written
    after another table (``image.layout``), torn (``image.torn``).
    """
    flat = SensorImage(*_decode(words, _INPUT))
    pressures: Any = flat.pressures_bar
    return flat._replace(pressures_bar=tuple(zip(pressures[0::2], pressures[1::2], strict=True)))


def encode_valves(image: ValveImage) -> list[int]:
    """The OUTPUT_WORDS words of ``image``, to be written from OUTPUT_ADDRESS on.

    Raises RequestRefused for NaN, infinity or a spool command beyond −1…1.
    """
    return _encode(image, _OUTPUT)


def decode_valves(words: Sequence[int]) -> ValveImage:
    """The image in OUTPUT_WORDS words written from OUTPUT_ADDRESS on; all zero: disabled, valves centred.

    Raises ImageRefused: wrong count (``image.bad_length``), not words at all (``image.not_words``), a spool
    command of −32768 (``image.out_of_range``), which is found in a torn image too, torn (``image.torn``).
    """
    return ValveImage(*_decode(words, _OUTPUT))


def _encode(values: Sequence[Any], codec: _Codec) -> list[int]:
    """The words of an image whose ``values`` are those of the codec's rows."""
    numbers: list[float] = []
    for value, row in zip(values, codec.rows, strict=True):
        if row.count == 1:
            numbers.append(value)
        elif len(value) == row.count:
            numbers += value
        else:
            raise RequestRefused(
                "refused.not_encodable", f"{row.name}: {len(value)} values, wanted {row.count}"
            )
    for place in codec.counters:
        numbers[place] %= CYCLE_MODULUS
    try:
        raw = list(map(round, map(mul, numbers, codec.scales)))
        return _pack(raw, codec)
    except (ValueError, OverflowError, struct.error):  # not finite, or out of range: which is found below
        return _pack(list(map(_raw, numbers, codec.values_of)), codec)


def _pack(raw: list[int], codec: _Codec) -> list[int]:
    """The words of ``raw``. Raises struct.error for a value that its row does not hold."""
    for place, constant in codec.constants:
        raw.insert(place, constant)
    for row, begin, end in codec.bounded:
        if min(raw[begin:end]) < row.low or max(raw[begin:end]) > row.high:
            raise struct.error(f"{row.name}: wanted {row.low}…{row.high}")
    return list(codec.words.unpack(codec.layout.pack(*raw, raw[0])))


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


def _decode(words: Sequence[int], codec: _Codec) -> list[Any]:
    """The values of the codec's rows, a tuple where a row has several."""
    if len(words) * 2 != codec.layout.size:
        raise ImageRefused("image.bad_length", f"{len(words)} words: the image has {codec.layout.size // 2}")
    try:
        numbers = codec.layout.unpack(codec.words.pack(*words))
    except struct.error as error:
        raise ImageRefused("image.not_words", f"not 16-bit words: {error}") from error
    for place, constant in codec.constants:
        if numbers[place] != constant:
            raise ImageRefused("image.layout", f"layout word {numbers[place]:#06x}: wanted {constant:#06x}")
    for row, begin, end in codec.bounded:
        least, most = min(numbers[begin:end]), max(numbers[begin:end])
        if least < row.low or most > row.high:
            number = least if least < row.low else most
            raise ImageRefused("image.out_of_range", f"{row.name} = {number}: wanted {row.low}…{row.high}")
    # Last: an impossible value is one in a torn image too, and is refused when it comes, not when it acts.
    if numbers[0] != numbers[-1]:
        raise ImageRefused("image.torn", f"cycle {numbers[0]} at the start, {numbers[-1]} at the end")
    values: list[Any] = []
    for begin, end, scale in codec.places:
        raw = numbers[begin:end]
        scaled = raw if scale == 1.0 else tuple([number / scale for number in raw])
        values.append(scaled[0] if end - begin == 1 else scaled)
    return values
