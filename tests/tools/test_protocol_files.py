"""The files for PLCs and programs: right by the golden datagrams, and run."""

import csv
import json
import math
import re
import struct
import zlib
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.channel import MAX_GAP_DATAGRAMS
from protocol.datagram import decode, encode
from protocol.datagram_layout import HEADER_BYTES, MAX_DATAGRAM_BYTES, PAYLOADS, TRAILER, Kind
from protocol.process_image import (
    INPUT_ADDRESS,
    SensorImage,
    ValveImage,
    encode_sensors,
    encode_valves,
)
from structured_text.memory import MemoryView
from structured_text.program import CompiledProgram
from tests.protocol.sample_messages import HEADER, MESSAGES
from tests.support.pages import signed_datagrams
from tests.support.paths import DOCS
from tools.pages import CASES, cases_csv

GOLDEN = [encode(message, HEADER) for message in MESSAGES]
WORD_CODES = {"UINT": "H", "INT": "h", "DINT": "i"}


def test_the_list_of_cases_is_that_of_the_suites() -> None:
    assert CASES.read_text(encoding="utf-8") == cases_csv(), "run: python -m tools.pages"


# Structured text, compiled and run.


@cache
def program() -> CompiledProgram:
    """All three texts."""
    return CompiledProgram(
        {
            name: ((DOCS / "protocol") / name).read_text(encoding="utf-8")
            for name in ("types_twincat_codesys.st", "helpers.st", "fields.st")
        }
    )


def datagram(data: bytes, rest: int = 0) -> MemoryView:
    """``data`` in an array of the PLC's, which goes on with ``rest``."""
    made = program().new("T_LR_Datagram")
    made.data[:] = data + bytes([rest]) * (MAX_DATAGRAM_BYTES - len(data))
    return made


def flat(value: Any) -> list[Any]:
    """All numbers of plain data, in order."""
    if isinstance(value, dict):
        return [number for part in value.values() for number in flat(part)]
    return [number for part in value for number in flat(part)] if isinstance(value, list) else [value]


def numbers(message: Any) -> list[Any]:
    """The numbers of a message in the order of its layout, padding as zeros."""
    kind = Kind(encode(message, HEADER)[6])
    found: list[Any] = []
    for field in PAYLOADS[kind]:
        if field.name == "padding":
            found += [0] * field.size
        elif field.name == "waypoint_count":
            found.append(len(message.waypoints))
        else:
            value = flat_message(getattr(message, field.name))
            found += value + [0.0] * (field.count - len(value))
    return found


def flat_message(value: Any) -> list[Any]:
    """The numbers of a message's field."""
    return [n for part in value for n in flat_message(part)] if isinstance(value, tuple) else [value]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_structured_text_reads_and_writes_every_datagram_as_the_codec_does(message: Any) -> None:
    data = encode(message, HEADER)
    kind = Kind(data[6]).name.title().replace("_", "")
    st_data = program().new(f"ST_LR_{kind}")
    assert program().call(f"F_LR_Read{kind}", aData=datagram(data), stData=st_data).result is True
    plain = st_data.as_dict()
    header = plain.pop("header")
    assert flat(plain) == numbers(message)
    assert (header["session"], header["sequence"], header["sent_ns"]) == (
        HEADER.session,
        HEADER.sequence,
        HEADER.sent_ns,
    )
    for name in ("crc32", "kind", "payload_bytes"):
        setattr(st_data.header, name, 0)
    st_data.header.magic = bytes(4)
    written = datagram(b"", 0xEE)
    assert program().call(f"F_LR_Write{kind}", aData=written, stData=st_data).result == len(data)
    assert bytes(written.data) == data + b"\xee" * (MAX_DATAGRAM_BYTES - len(data))
    assert decode(bytes(written.data[: len(data)])) == decode(data)


def test_structured_text_reads_the_trailer_and_makes_the_crc_of_a_signed_datagram() -> None:
    for data in signed_datagrams().values():
        trailer = program().new("ST_LR_Trailer")
        at = HEADER_BYTES + struct.unpack_from("<H", data, 10)[0]
        assert program().call("F_LR_ReadTrailer", aData=datagram(data), stData=trailer, nAt=at).result is True
        assert bytes(trailer.tag.data) == data[-16:]
        assert trailer.sequence_high == 7
        assert len(trailer.as_dict()) == len(TRAILER)
        crc = program().call("F_LR_DatagramCrc", aData=datagram(data), nBytes=len(data)).result
        assert crc == struct.unpack_from("<I", data, 12)[0]
        bare = datagram(data[:at])
        assert program().call("F_LR_WriteTrailer", aData=bare, stData=trailer, nAt=at).result is True
        assert bytes(bare.data[: len(data)]) == data


def test_structured_text_has_the_crc_of_the_page() -> None:
    crc = (
        program().call("F_LR_Crc", aData=datagram(b"123456789"), nFirst=0, nCount=9, nSeed=0xFFFFFFFF).result
    )
    assert crc ^ 0xFFFFFFFF == zlib.crc32(b"123456789") == 0xCBF43926


SPECIAL = [0.0, -0.0, 1.0, -1.0, 5e-324, 2.2250738585072014e-308, -1.7976931348623157e308]
SPECIAL += [
    1.5 * 2.0**-1023,
    math.inf,
    -math.inf,
    math.nan,
    math.nextafter(1.0, 0.0),
    math.nextafter(2.0, 0.0),
    2.0**52 + 0.5,
]


def put_and_got(value: float) -> None:
    """Both directions of an LREAL, bit by bit; what 3.7 refuses is said, not taken for a number."""
    data = struct.pack("<d", value)
    normal = math.isfinite(value) and (value == 0.0 or abs(value) >= 2.0**-1022)
    got = program().call("F_LR_GetLreal", aData=datagram(b"\xee" * 8 + data), nAt=8, xFinite=True)
    assert got.outputs["xFinite"] is normal
    assert got.result == (value if normal else 0.0)
    written = datagram(b"", 0xEE)
    done = program().call("F_LR_PutLreal", aData=written, nAt=8, fValue=value).result
    assert done is math.isfinite(value)
    put = data if normal and value != 0.0 else bytes(8)
    assert bytes(written.data[:24]) == b"\xee" * 8 + (put if done else b"\xee" * 8) + b"\xee" * 8


@pytest.mark.parametrize("value", SPECIAL)
def test_structured_text_has_every_binary64_at_the_edges(value: float) -> None:
    put_and_got(value)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**64 - 1))
def test_structured_text_has_every_binary64(bits: int) -> None:
    put_and_got(struct.unpack("<d", bits.to_bytes(8, "little"))[0])


def test_a_reference_with_a_nan_reads_as_not_finite_and_is_not_written() -> None:
    message = next(m for m in MESSAGES if type(m).__name__ == "ReferencePose")
    data = bytearray(encode(message, HEADER))
    data[48:56] = struct.pack("<d", math.nan)
    pose, there = program().new("ST_LR_ReferencePose"), datagram(b"")
    assert program().call("F_LR_ReadReferencePose", aData=datagram(bytes(data)), stData=pose).result is False
    assert program().call("F_LR_WriteReferencePose", aData=there, stData=pose).result == 112
    pose.duration_s = math.inf
    assert program().call("F_LR_WriteReferencePose", aData=there, stData=pose).result == 0


@pytest.mark.parametrize(
    ("sequence", "newest", "newer", "skipped"),
    [
        (5, 4, True, 0), (4, 4, False, 0), (3, 4, False, 0), (9, 4, True, 4), (2, 2**32 - 3, True, 4),
        (2**32 - 1, 0, False, 0), (MAX_GAP_DATAGRAMS, 0, True, MAX_GAP_DATAGRAMS - 1),
        (MAX_GAP_DATAGRAMS + 1, 0, False, 0),
    ],
)  # fmt: skip
def test_structured_text_orders_numbers_as_the_channel_does(
    sequence: int, newest: int, newer: bool, skipped: int
) -> None:
    found = program().call("F_LR_IsNewer", nSequence=sequence, nNewest=newest)
    assert (found.result, found.outputs["nSkipped"]) == (newer, skipped)


def test_structured_text_reads_the_inputs_and_writes_the_outputs() -> None:
    counts = (1, -1, 2**31 - 1, -(2**31), 65536, -65537)
    words = program().new("T_LR_InputWords")
    words.numbers[:] = encode_sensors(SensorImage(7, 9, 5, counts, ((1.0, 2.0),) * 6, 190.0, 10.0, -4.25))
    inputs = program().new("ST_LR_Inputs")
    assert program().call("F_LR_ReadInputs", aWords=words, stData=inputs).result is True
    assert list(inputs.encoder_counts) == list(counts)
    assert (inputs.plant_cycle, inputs.echo_cycle, inputs.status) == (7, 9, 5)
    assert (list(inputs.pressures_bar)[:2], inputs.oil_temperature_degc) == ([100, 200], -425)
    words[39] += 1
    assert program().call("F_LR_ReadInputs", aWords=words, stData=inputs).result is False
    outputs = program().new("ST_LR_Outputs")
    outputs.controller_cycle, outputs.control = 17, 1
    outputs.valves = [16384, -8192, 32767, -32767, 0, 4096]
    written = program().new("T_LR_OutputWords")
    written.numbers[:] = 0xEEEE
    assert program().call("F_LR_WriteOutputs", aWords=written, stData=outputs).result is True
    valves = tuple(value / 32767 for value in outputs.valves)
    assert list(written) == encode_valves(ValveImage(17, 1, valves))


@pytest.mark.parametrize("name", ["types_twincat_codesys.st", "helpers.st", "fields.st"])
def test_a_parser_of_others_reads_the_text(name: str) -> None:
    blark = pytest.importorskip("blark.parse", reason="blark is not installed: make peers")
    path = (DOCS / "protocol") / name
    (parsed,) = blark.parse(path)
    assert parsed.exception is None
    declared = re.findall(r"^FUNCTION (\w+)|^(\w+) : (?:STRUCT|ARRAY)", path.read_text(), re.MULTILINE)
    assert len(parsed.transform().items) == len(declared)


# JSON and CSV.


@pytest.mark.parametrize(("message", "data"), list(zip(MESSAGES, GOLDEN, strict=True)))
def test_a_reader_with_the_json_alone_reads_every_datagram(message: Any, data: bytes) -> None:
    layout = json.loads(((DOCS / "protocol") / "datagrams.json").read_text(encoding="utf-8"))
    codes = {"BYTE": "B", "USINT": "B", "UINT": "H", "UDINT": "I", "ULINT": "Q", "LREAL": "d"}
    names = {value: name for name, value in layout["enumerations"]["Kind"].items()}
    payload = layout["payloads"][names[data[6]]]
    assert len(data) == layout["header"]["bytes"] + payload["bytes"]
    found = []
    for field in payload["fields"]:
        at = layout["header"]["bytes"] + field["offset"]
        found += struct.unpack_from(f"<{field['count']}{codes[field['type']]}", data, at)
    assert found == numbers(message)
    for field in payload["fields"]:
        if "enumeration" in field:
            at = layout["header"]["bytes"] + field["offset"]
            (value,) = struct.unpack_from("<" + codes[field["type"]], data, at)
            assert value in layout["enumerations"][field["enumeration"]].values()


def test_a_reader_with_the_register_map_alone_reads_the_inputs() -> None:
    image = SensorImage(7, 9, 5, (1, -2, 3, -4, 5, -6), ((1.0, 2.5),) * 6, 190.0, 10.0, -4.25)
    words = encode_sensors(image)
    with ((DOCS / "protocol") / "registers.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    read = {}
    for row in (row for row in rows if row["block"] == "inputs"):
        at, count = int(row["address"]) - INPUT_ADDRESS, int(row["count"])
        raw = b"".join(word.to_bytes(2, "little") for word in words[at : at + int(row["words"])])
        values = struct.unpack(f"<{count}{WORD_CODES[row['type']]}", raw)
        assert all(int(row["low"]) <= value <= int(row["high"]) for value in values)
        read[row["name"]] = [value * float(row["one_digit"]) for value in values]
    assert read["encoder_counts"] == list(image.encoder_counts)
    assert read["pressures_bar"] == pytest.approx([1.0, 2.5] * 6)
    assert read["oil_temperature_degc"] == pytest.approx([-4.25])
    assert read["plant_cycle"] == read["plant_cycle_again"] == [7.0]
