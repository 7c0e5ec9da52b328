"""The files in docs/protocol/, for PLCs and programs; ``python -m tools.protocol_files`` writes them."""

import csv
import io
import json
import re
from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import Any

from conformance.runner import coupler_cases, reference_cases
from protocol.coupler_registers import COUPLER_TABLE
from protocol.datagram_layout import (
    HEADER,
    HEADER_BYTES,
    MAX_DATAGRAM_BYTES,
    PAYLOADS,
    TRAILER,
    VERSION_MAJOR,
    VERSION_MINOR,
    Field,
    Kind,
    offsets,
    size_of,
)
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.process_image import INPUT_TABLE, OUTPUT_TABLE, Register
from tools import plc
from tools.pages import word_codes
from tools.plc import IEC, IEC_WORDS
from tools.protocol_page import ROOT

FOLDER = ROOT / "docs" / "protocol"
ENUMERATIONS: tuple[type[IntEnum], ...] = (Kind, CommandCode, Reason, GroupState, FaultCode, Severity)


def datagrams() -> str:
    """Header, payloads, trailer and enumerations as JSON."""
    data = {
        "schema": "longreach.reference_link",
        "version": f"{VERSION_MAJOR}.{VERSION_MINOR}",
        "byte_order": "little",
        "max_datagram_bytes": MAX_DATAGRAM_BYTES,
        "header": {"bytes": HEADER_BYTES, "fields": _fields(HEADER)},
        "payloads": {
            kind.name: {"kind": kind.value, "bytes": size_of(fields), "fields": _fields(fields)}
            for kind, fields in PAYLOADS.items()
        },
        "trailer": {"bytes": size_of(TRAILER), "fields": _fields(TRAILER)},
        "enumerations": {
            each.__name__: {member.name: member.value for member in each} for each in ENUMERATIONS
        },
    }
    return _readable(data)


def _readable(data: dict[str, Any]) -> str:
    """JSON with what has no parts of its own on one line."""
    text = json.dumps(data, indent=1, ensure_ascii=False)
    for inner in (r"\[[^\[\]{}]*\]", r"\{[^{}]*\}"):
        text = re.sub(inner, lambda found: re.sub(r"\s*\n\s*", " ", found[0]), text)
    return text + "\n"


def _fields(fields: tuple[Field, ...]) -> list[dict[str, Any]]:
    """Offset from the first of ``fields``, type, count, unit, range and meaning of each."""
    return [
        {
            "name": field.name,
            "offset": offset,
            "type": IEC[field.code],
            "count": field.size if field.code.endswith("s") else field.count,
            "unit": field.unit,
            **({"enumeration": field.enum.__name__} if field.enum else {}),
            **({"low": field.low, "high": field.highest} if field.code in "BHIQ" and not field.enum else {}),
            "meaning": field.meaning,
        }
        for field, offset in zip(fields, offsets(fields), strict=True)
    ]


def _registers() -> Iterator[dict[str, Any]]:
    """Every register of the process image and of the coupler itself."""
    for block, rows in (("inputs", INPUT_TABLE), ("outputs", OUTPUT_TABLE)):
        for row in rows:
            yield _register(block, row)
    for own in COUPLER_TABLE:
        yield {
            "block": "coupler", "address": own.address, "words": own.words, "name": own.name,
            "type": "UINT", "count": own.words, "unit": own.unit, "one_digit": 1.0,
            "low": 0, "high": 0xFFFF, **_codes(own.address, own.words), "meaning": own.meaning,
        }  # fmt: skip


def _register(block: str, row: Register) -> dict[str, Any]:
    low, high = (row.constant, row.constant) if row.constant is not None else (row.low, row.high)
    return {
        "block": block, "address": row.address, "words": row.words, "name": row.name,
        "type": IEC_WORDS[row.code], "count": row.count, "unit": row.unit,
        "one_digit": 1.0 / row.scale, "low": low, "high": high,
        **_codes(row.address, row.words), "meaning": row.meaning,
    }  # fmt: skip


def _codes(address: int, words: int) -> dict[str, list[int]]:
    read, write = word_codes(address, words)
    return {"read_with": read, "write_with": write}


def registers_json() -> str:
    """The registers as JSON; ``low`` and ``high`` bound the raw number, value = raw times ``one_digit``."""
    data = {"schema": "longreach.process_image", "low_word_first": True, "registers": list(_registers())}
    return _readable(data)


def registers_csv() -> str:
    """The same, a line a register; addresses in decimal, as masters and their configurators take them."""
    rows = list(_registers())
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(rows[0])
    for row in rows:
        values = row.values()
        writer.writerow(" ".join(map(str, value)) if isinstance(value, list) else value for value in values)
    return out.getvalue()


def cases_csv() -> str:
    """Every case of both suites: number, clause that it cites, whether it moves or writes, question."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("suite", "case", "clause", "moves", "question"))
    for suite, cases in (("reference", reference_cases()), ("coupler", coupler_cases())):
        writer.writerows((suite, c.number, c.clause, "yes" if c.motion else "", c.title) for c in cases)
    return out.getvalue()


FILES: dict[str, Callable[[], str]] = {
    "types_twincat_codesys.st": plc.types,
    "fields.st": plc.fields,
    "datagrams.json": datagrams,
    "registers.json": registers_json,
    "registers.csv": registers_csv,
    "cases.csv": cases_csv,
}

if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, made in FILES.items():
        (FOLDER / name).write_text(made(), encoding="utf-8")
