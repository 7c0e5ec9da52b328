"""The process image: every register where the table says, torn and foreign images refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import ImageRefused, RequestRefused
from protocol.process_image import (
    INPUT_ADDRESS,
    INPUT_TABLE,
    INPUT_WORDS,
    OUTPUT_ADDRESS,
    OUTPUT_TABLE,
    OUTPUT_WORDS,
    Register,
    SensorImage,
    ValveImage,
    decode_sensors,
    decode_valves,
    encode_sensors,
    encode_valves,
)

SENSORS = SensorImage(
    plant_cycle=0x1234,
    echo_cycle=0x0234,
    status=0b1011,
    encoder_counts=(1, -2, 65536, -65537, 2**31 - 1, -(2**31)),
    pressures_bar=((1.01, 2.0), (3.0, 4.0), (5.0, 6.0), (7.0, 8.0), (9.0, 10.0), (11.0, 655.35)),
    supply_bar=210.0,
    return_bar=1.5,
    oil_temperature_degc=-12.5,
)
VALVES = ValveImage(0xFEDC, 0b01, (0.0, 1.0, -1.0, 0.5, -0.25, 0.0))

GOLDEN_SENSORS = [
    0x1234, 0x4C01, 0x0234, 0x000B,
    0x0001, 0x0000, 0xFFFE, 0xFFFF, 0x0000, 0x0001, 0xFFFF, 0xFFFE, 0xFFFF, 0x7FFF, 0x0000, 0x8000,
    101, 200, 300, 400, 500, 600, 700, 800, 900, 1000, 1100, 65535,
    21000, 150, 0xFB1E, 0, 0, 0, 0, 0, 0, 0, 0, 0x1234,
]  # fmt: skip
GOLDEN_VALVES = [0xFEDC, 1, 0, 0x7FFF, 0x8001, 0x4000, 0xE000, 0, 0, 0, 0, 0xFEDC]

word = st.integers(0, 0xFFFF)
centibar = st.integers(0, 0xFFFF).map(lambda raw: raw / 100)
sensor_images = st.builds(
    SensorImage,
    word,
    word,
    word,
    st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 6),
    st.tuples(*[st.tuples(centibar, centibar)] * 6),
    centibar,
    centibar,
    st.integers(-(2**15), 2**15 - 1).map(lambda raw: raw / 100),
)
valve_images = st.builds(
    ValveImage, word, word, st.tuples(*[st.integers(-32767, 32767).map(lambda raw: raw / 32767)] * 6)
)


@given(sensor_images)
def test_sensors_come_back_as_they_were_measured(image: SensorImage) -> None:
    assert decode_sensors(encode_sensors(image)) == image


@given(valve_images)
def test_valves_come_back_as_they_were_commanded(image: ValveImage) -> None:
    assert decode_valves(encode_valves(image)) == image


def test_the_words_on_the_bus_are_these() -> None:
    assert encode_sensors(SENSORS) == GOLDEN_SENSORS
    assert encode_valves(VALVES) == GOLDEN_VALVES


@pytest.mark.parametrize(
    ("table", "start", "words"),
    [(INPUT_TABLE, INPUT_ADDRESS, INPUT_WORDS), (OUTPUT_TABLE, OUTPUT_ADDRESS, OUTPUT_WORDS)],
)
def test_the_table_has_neither_gap_nor_overlap(table: tuple[Register, ...], start: int, words: int) -> None:
    address = start
    for row in table:
        assert row.address == address
        assert row.code == "H" or not row.reserved
        if row.code == "i":
            assert (address - start) % 2 == 0  # a PLC that aligns its DINT agrees with one that packs
        address += row.words
    assert address - start == words


def test_all_words_zero_is_a_safe_valve_image() -> None:
    assert decode_valves([0] * OUTPUT_WORDS) == ValveImage(0, 0, (0.0,) * 6)


@pytest.mark.parametrize("count", [0, 39, 41])
def test_a_wrong_number_of_words_is_refused(count: int) -> None:
    with pytest.raises(ImageRefused) as caught:
        decode_sensors([0] * count)
    assert caught.value.cause == "image.bad_length"
    with pytest.raises(ImageRefused) as caught:
        decode_valves([0] * (count or 11))
    assert caught.value.cause == "image.bad_length"


@pytest.mark.parametrize("torn_at", range(1, INPUT_WORDS))
def test_an_image_read_in_two_pieces_is_torn(torn_at: int) -> None:
    before = encode_sensors(SENSORS)
    after = encode_sensors(SENSORS._replace(plant_cycle=SENSORS.plant_cycle + 1))
    for mixed in (before[:torn_at] + after[torn_at:], after[:torn_at] + before[torn_at:]):
        with pytest.raises(ImageRefused) as caught:
            decode_sensors(mixed)
        assert caught.value.cause == "image.torn"


@pytest.mark.parametrize("torn_at", range(1, OUTPUT_WORDS))
def test_an_image_written_in_two_pieces_is_torn(torn_at: int) -> None:
    mixed = encode_valves(VALVES)[:torn_at] + encode_valves(VALVES._replace(controller_cycle=1))[torn_at:]
    with pytest.raises(ImageRefused) as caught:
        decode_valves(mixed)
    assert caught.value.cause == "image.torn"


@pytest.mark.parametrize("layout", [0, 0x4C02, 0xFFFF])
def test_an_image_of_another_table_is_refused(layout: int) -> None:
    words = encode_sensors(SENSORS)
    words[1] = layout
    with pytest.raises(ImageRefused) as caught:
        decode_sensors(words)
    assert caught.value.cause == "image.layout"


@pytest.mark.parametrize("torn", [0, 1])
def test_the_one_spool_word_without_a_mirror_is_refused_in_a_torn_image_too(torn: int) -> None:
    words = encode_valves(VALVES)
    words[4] = 0x8000
    words[-1] ^= torn
    with pytest.raises(ImageRefused) as caught:
        decode_valves(words)
    assert caught.value.cause == "image.out_of_range"


@pytest.mark.parametrize("odd", [-1, 65536, 1.5, None])
def test_numbers_that_are_no_words_are_refused(odd: int) -> None:
    words = encode_valves(VALVES)
    words[2] = odd
    with pytest.raises(ImageRefused) as caught:
        decode_valves(words)
    assert caught.value.cause == "image.not_words"


def test_counters_wrap_and_transmitters_saturate() -> None:
    image = SENSORS._replace(
        plant_cycle=65536 + 7,
        echo_cycle=-1,
        supply_bar=1e9,
        return_bar=-3.0,
        oil_temperature_degc=400.0,
    )
    got = decode_sensors(encode_sensors(image))
    assert (got.plant_cycle, got.echo_cycle) == (7, 65535)
    assert (got.supply_bar, got.return_bar, got.oil_temperature_degc) == (655.35, 0.0, 327.67)


def test_reserved_words_are_ignored() -> None:
    words = encode_sensors(SENSORS)
    words[31:39] = range(1, 9)
    assert decode_sensors(words) == SENSORS


@pytest.mark.parametrize("odd", [math.nan, math.inf])
def test_a_number_that_is_none_never_reaches_the_bus(odd: float) -> None:
    with pytest.raises(RequestRefused, match="supply_bar"):
        encode_sensors(SENSORS._replace(supply_bar=odd))
    with pytest.raises(RequestRefused, match="valves"):
        encode_valves(VALVES._replace(valves=(0.0, odd, 0.0, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("too_far", [1.0001, -1.0001])
def test_a_spool_command_beyond_full_scale_is_refused(too_far: float) -> None:
    with pytest.raises(RequestRefused, match=r"-1…1"):
        encode_valves(VALVES._replace(valves=(too_far, 0.0, 0.0, 0.0, 0.0, 0.0)))


def test_encoder_counts_beyond_32_bits_and_missing_chambers_are_refused() -> None:
    with pytest.raises(RequestRefused, match="encoder_counts"):
        encode_sensors(SENSORS._replace(encoder_counts=(2**31, 0, 0, 0, 0, 0)))
    with pytest.raises(RequestRefused, match="pressures_bar"):
        encode_sensors(SENSORS._replace(pressures_bar=SENSORS.pressures_bar[:5]))
