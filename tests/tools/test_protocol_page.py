"""The written protocol against the code: its tables, its causes, its PLC types, and its order of checks."""

import hmac
import itertools
import json
import re
import struct
import zlib
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import pytest

from conformance.wire import resealed
from protocol import datagram_layout, process_image, reference_messages
from protocol.authentication import LinkKey
from protocol.datagram import decode, encode
from protocol.datagram_layout import (
    HEADER_BYTES,
    MAX_DATAGRAM_BYTES,
    PAYLOADS,
    TRAILER_BYTES,
    Kind,
)
from protocol.errors import DatagramRefused
from protocol.pose import Pose
from protocol.process_image import INPUT_TABLE, OUTPUT_TABLE
from protocol.reference_messages import Hello
from tests.protocol.sample_messages import HEADER, MESSAGES
from tests.support.pages import page, signed_datagrams, table_below
from tests.support.paths import ROOT

TEXT = page("protocol.md")
GOLDEN = json.loads((ROOT / "tests/protocol/golden_datagrams.json").read_text())
WORD_TYPES = {"H": "UINT", "h": "INT", "i": "DINT"}
STRUCT_CODES = {"USINT": "B", "BYTE": "B", "UINT": "H", "UDINT": "I", "ULINT": "Q", "LREAL": "d"}


BITS = {
    "flags": (datagram_layout, "FLAG_"),
    "capabilities": (reference_messages, "CAPABILITY_"),
    "state flags": (reference_messages, "FLAG_"),
    "status bits": (process_image, "STATUS_"),
    "control bits": (process_image, "CONTROL_"),
}


@pytest.mark.parametrize("table", BITS)
def test_every_bit_is_written_down_and_no_other(table: str) -> None:
    module, prefix = BITS[table]
    masks = {name.removeprefix(prefix): m for name, m in vars(module).items() if name.startswith(prefix)}
    assert {name: 1 << int(bit) for bit, name, _ in rows_after(f"<!-- table: {table} -->")} == masks


@pytest.mark.parametrize("table", ["inputs", "outputs"])
def test_every_register_is_written_down_and_no_other(table: str) -> None:
    registers = {"inputs": INPUT_TABLE, "outputs": OUTPUT_TABLE}[table]
    for row, cells in zip(registers, rows_after(f"<!-- table: {table} -->"), strict=True):
        address, words, name, kind, digit, span, meaning = cells
        assert (int(address, 16), int(words), name, meaning) == (
            row.address,
            row.words,
            row.name,
            row.meaning,
        )
        assert float(Fraction(digit)) == pytest.approx(1 / row.scale)
        assert kind == WORD_TYPES[row.code] + (f"[{row.count}]" if row.count > 1 else "")
        if row.constant is None and not row.reserved:
            assert span == f"{row.low / row.scale:.10g}…{row.high / row.scale:.10g} {row.unit}".strip()


def test_every_cause_of_a_drop_is_written_down_and_no_other() -> None:
    source = "".join(path.read_text() for path in (ROOT / "protocol").glob("*.py"))
    pattern = r"[\"`]((?:datagram|authentication|session|sequence|clock)\.[a-z_]+)[\"`]"
    used = set(re.findall(pattern, source)) - {"datagram.", "sequence.new"}
    assert set(re.findall(pattern, TEXT)) == used
    images = set(re.findall(r"[\"`](image\.[a-z_]+)[\"`]", source))
    assert set(re.findall(r"`(image\.[a-z_]+)`", TEXT)) == images


def rows_after(heading: str) -> list[list[str]]:
    """Cells of the first table behind ``heading`` in the page."""
    return table_below(TEXT, heading)


def read_by_the_page(heading: str, data: bytes, base: int) -> dict[str, Any]:
    """Fields of ``data`` by offset and type of the page alone."""
    fields: dict[str, Any] = {}
    for offset, name, kind, *_ in rows_after(heading):
        match = re.match(r"(\w+)(?:\[(\d+)\])?(?: |$)", kind)
        assert match is not None
        count = int(match[2] or 1)
        values = struct.unpack_from(f"<{count}{STRUCT_CODES[match[1]]}", data, base + int(offset))
        fields[name] = values[0] if count == 1 else values
    return fields


def flat(value: Any) -> Any:
    """A message's field as the page's table lists it."""
    if isinstance(value, Pose):
        return (*value.p_m, *value.q_wxyz)
    return value


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_a_reader_with_the_page_alone_reads_every_datagram(message: Any) -> None:
    name = type(message).__name__
    data = bytes.fromhex(GOLDEN[name])
    head = read_by_the_page("**3.1**", data, 0)
    assert bytes(head["magic"]) == b"LRLK"
    assert {key: head[key] for key in HEADER._asdict()} == HEADER._asdict()
    assert head["payload_bytes"] == len(data) - HEADER_BYTES
    kind = Kind(head["kind"])
    assert kind.name.replace("_", "") == name.upper()
    payload = f"payload {len(data) - HEADER_BYTES} bytes, datagram {len(data)}"
    heading = f"**{kind.name}** (kind {kind.value}): {payload}"
    written = [(cells[1], cells[3]) for cells in rows_after(heading)]
    assert written == [(field.name, field.meaning) for field in PAYLOADS[kind]]
    assert all(f.unit in cells[2] for f, cells in zip(PAYLOADS[kind], rows_after(heading), strict=True))
    assert f"{kind.value} {kind.name}" in TEXT[TEXT.index("**3.8**") : TEXT.index("**3.9**")]
    fields = read_by_the_page(heading, data, HEADER_BYTES)
    for key, value in message._asdict().items():
        if key == "waypoints":
            numbers = [number for pose in value for number in flat(pose)]
            assert fields["waypoint_count"] == len(value)
            assert list(fields[key]) == numbers + [0.0] * (168 - len(numbers))
        else:
            assert fields[key] == flat(value)
    assert data.hex() in re.sub(r"\s", "", TEXT)


def derived(secret: bytes, label: str, *numbers: int) -> bytes:
    """KDF of clause 11.6, from its words."""
    context = b"".join(number.to_bytes(8, "little") for number in numbers)
    text = b"\x00\x00\x00\x01" + label.encode() + b"\x00" + context + b"\x00\x00\x01\x00"
    return hmac.new(secret, text, "sha256").digest()


def test_a_reader_with_the_page_alone_verifies_every_signed_datagram() -> None:
    labels = {row[0]: row[1].strip("`") for row in rows_after("<!-- table: keys -->")}
    secret = bytes(range(32))
    numbers = (0x0102030405060708, 0x1122334455667788, 0xB1B2B3B4B5B6B7B8)
    keys = {"Hello": derived(secret, labels["K_hello"])}
    keys["Welcome"] = derived(secret, labels["K_controller"], *numbers)
    of_client = derived(secret, labels["K_client"], *numbers)
    of_ours = LinkKey(secret).of_client(*numbers)
    ours = {"Hello": LinkKey(secret).of_hello(), "Welcome": of_ours.receives}
    signed = signed_datagrams()
    assert {"Hello", "Welcome", "ReferencePose", "Bye"} <= set(signed)
    for name, data in signed.items():
        end = HEADER_BYTES + struct.unpack_from("<H", data, 10)[0]
        trailer = read_by_the_page("<!-- table: trailer -->", data, end)
        assert len(data) == end + TRAILER_BYTES
        assert data[9] == 1
        assert trailer["sequence_high"] == 7
        assert trailer["key_id"] == int.from_bytes(derived(secret, "LRLK 1 key id")[:4], "little")
        header, message = decode(data)
        assert message in MESSAGES
        assert encode(message, header, ours.get(name, of_ours.sends)) == data
        tag = hmac.new(keys.get(name, of_client), data[:12] + data[16:-16], "sha256").digest()[:16]
        assert bytes(trailer["tag"]) == tag, name
        assert zlib.crc32(data[16:], zlib.crc32(data[:12])) == struct.unpack_from("<I", data, 12)[0]


RAW_FAULTS: list[tuple[str, Callable[[bytearray], None]]] = [
    ("datagram.bad_magic", lambda d: d.__setitem__(0, 0)),
    ("datagram.wrong_major", lambda d: d.__setitem__(4, 2)),
    ("datagram.bad_length", lambda d: d.__setitem__(10, 33)),
    ("datagram.bad_crc", lambda d: d.__setitem__(12, d[12] ^ 1)),
    ("datagram.unknown_critical_flag", lambda d: d.__setitem__(9, 2)),
    ("datagram.unknown_kind", lambda d: d.__setitem__(6, 200)),
    ("datagram.wrong_payload_length", lambda d: d.__setitem__(6, 2)),
    ("datagram.bad_value", lambda d: d.__setitem__(slice(40, 48), bytes(8))),
]


def test_the_first_check_that_fails_names_the_cause_in_the_order_of_the_page() -> None:
    written = [row[1].strip("`") for row in rows_after("**3.5**")]
    order = [cause for cause, _ in RAW_FAULTS]
    assert [cause for cause in written if cause in order] == order
    for (first, spoil_first), (second, spoil_second) in itertools.combinations(RAW_FAULTS, 2):
        if {first, second} == {"datagram.unknown_kind", "datagram.wrong_payload_length"}:
            continue  # both are written in the same byte
        data = bytearray(encode(Hello(1, 2, 3, 4), HEADER))
        spoil_second(data)
        if "datagram.bad_crc" not in (first, second):
            data = bytearray(resealed(bytes(data)))
        spoil_first(data)
        if order.index(first) > order.index("datagram.bad_crc"):
            data = bytearray(resealed(bytes(data)))
        with pytest.raises(DatagramRefused) as caught:
            decode(bytes(data))
        assert caught.value.cause == first, (first, second)


def test_size_is_checked_before_anything_else() -> None:
    assert written_causes()[:2] == ["datagram.too_short", "datagram.too_long"]
    for size, cause in [(39, "datagram.too_short"), (MAX_DATAGRAM_BYTES + 1, "datagram.too_long")]:
        with pytest.raises(DatagramRefused) as caught:
            decode(bytes(size))
        assert caught.value.cause == cause


def written_causes() -> list[str]:
    return [row[1].strip("`") for row in rows_after("**3.5**")]
