"""The Lua dissector against the codec's tables."""

import re

from dissector.generate import SCRIPT, dissector
from protocol.datagram_layout import HEADER, PAYLOADS, TRAILER


def test_the_script_is_the_one_of_the_tables() -> None:
    assert SCRIPT.read_text(encoding="utf-8") == dissector(), "run: python -m dissector.generate"


def test_every_field_of_every_kind_is_shown_once() -> None:
    text = SCRIPT.read_text(encoding="utf-8")
    expected = {field.name for field in HEADER} | {f"trailer.{field.name}" for field in TRAILER}
    for kind, fields in PAYLOADS.items():
        expected |= {f"{kind.name.lower()}.{field.name}" for field in fields if field.code != "x"}
    defined = re.findall(r'^f\["([^"]+)"\] = ', text, re.MULTILINE)
    assert sorted(defined) == sorted(expected)
    assert sorted(re.findall(r'^  \{ f\["([^"]+)"\], ', text, re.MULTILINE)) == sorted(expected)
