"""The generated tables of docs/protocol.md; ``python -m tools.protocol_page`` writes them."""

import json
import re
import textwrap
from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path
from typing import TypeVar

from protocol import datagram_layout, process_image, reference_messages
from protocol.authentication import LinkKey
from protocol.axes_group import ANSWERS, Asked, Mode
from protocol.datagram import encode
from protocol.datagram_layout import (
    HEADER,
    HEADER_BYTES,
    PAYLOADS,
    TRAILER,
    Field,
    Kind,
    offsets,
    size_of,
)
from protocol.faults import (
    COMMAND_TEXTS,
    FAULT_TEXTS,
    GROUP_STATE_TEXTS,
    REASON_TEXTS,
    SEVERITY_TEXTS,
    CommandCode,
    FaultCode,
    GroupState,
    Reason,
    Severity,
)
from protocol.process_image import INPUT_TABLE, OUTPUT_TABLE, Register
from protocol.reference_messages import Bye, Heartbeat, Hello, ReferencePose, Welcome
from tools.sample_messages import HEADER as HEADER_SAMPLE
from tools.sample_messages import MESSAGES
from tools.tables import (
    CLIENT_ROWS,
    KEY_SERVER_ROWS,
    SERVER_ROWS,
    Row,
    limits,
    motion_limits,
    stream_limits,
    table,
)

IEC = {"B": "USINT", "H": "UINT", "I": "UDINT", "Q": "ULINT", "d": "LREAL", "x": "BYTE"} | {
    "4s": "BYTE",
    "16s": "BYTE",
}
IEC_WORDS = {"H": "UINT", "h": "INT", "i": "DINT"}
ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "protocol.md"
GOLDEN = Path(__file__).parent / "golden_datagrams.json"
Member = TypeVar("Member", bound=IntEnum)
KEY_ROWS = (
    ("K_hello", "`LRLK 1 hello`", "nothing", "HELLO"),
    (
        "K_client",
        "`LRLK 1 client`",
        "client_nonce ‖ session ‖ boot_id",
        "what the client sends in the session",
    ),
    (
        "K_controller",
        "`LRLK 1 controller`",
        "the same",
        "WELCOME and what the controller sends in the session",
    ),
)
CAPABILITIES = {
    "PATHS": "REFERENCE_PATH is understood",
    "STREAMING": "START_STREAM, END_STREAM, STREAMED_POSE and STREAM_REFUSED are understood",
    "AUTHENTICATION": "every datagram of the session is signed (clause 11)",
    "VALVE_TRIALS": "ENABLE begins a trial of the valves: the controller was started for that,"
    " and follows no reference",
}
COLUMNS = {Asked.MOVE: "reference", Asked.STREAMED: "streamed reference"}


def filled(page: str, sections: Mapping[str, str]) -> str:
    """``page`` with ``sections`` between their marks."""

    def fill(match: re.Match[str]) -> str:
        return f"{match[1]}\n{sections[match[2]]}\n{match[3]}"

    return re.sub(r"(<!-- generated: ([a-z ]+) -->)\n.*?(<!-- end -->)", fill, page, flags=re.DOTALL)


def datagram_table(fields: tuple[Field, ...]) -> str:
    """Offset (from the start of these fields), type with range and unit, and meaning of every field."""

    def span(field: Field) -> str:
        if field.enum is not None:
            return field.enum.__name__
        if field.code not in "BHIQ" or (field.low == 0 and field.high is None):
            return ""
        return f"{field.low}…{field.highest}" if field.low < field.highest else str(field.low)

    rows = (
        (offset, field.name, _words(_counted(IEC[field.code], field), span(field), field.unit), field.meaning)
        for field, offset in zip(fields, offsets(fields), strict=True)
    )
    return table("offset | field | type, range, unit | meaning", rows)


def _words(*parts: str) -> str:
    return " ".join(part for part in parts if part)


def _counted(kind: str, field: Field) -> str:
    count = field.size if field.code.endswith("s") else field.count
    return f"{kind}[{count}]" if count > 1 else kind


def payload_tables() -> str:
    """One table a kind."""
    parts = []
    for kind, fields in PAYLOADS.items():
        size = size_of(fields)
        parts.append(
            f"**{kind.name}** (kind {kind.value}): payload {size} bytes, datagram {HEADER_BYTES + size}\n\n"
            + datagram_table(fields)
        )
    return "\n\n".join(parts)


def register_table(rows: tuple[Register, ...]) -> str:
    """Address, type, range with unit, scale and meaning of every register."""

    def span(row: Register) -> str:
        if row.constant is not None:
            return f"{row.constant:#06x}"
        if row.reserved:
            return "0"
        return f"{row.low / row.scale:.10g}…{row.high / row.scale:.10g}"

    return table(
        "address | words | register | type | 1 digit | range, unit | meaning",
        (
            (
                f"{row.address:#06x}", row.words, row.name,
                IEC_WORDS[row.code] + (f"[{row.count}]" if row.count > 1 else ""),
                f"1/{row.scale:g}" if row.scale != 1.0 else 1, f"{span(row)} {row.unit}".strip(), row.meaning,
            )
            for row in rows
        ),
    )  # fmt: skip


def enumeration(members: type[Member], texts: dict[Member, str]) -> str:
    """Number, name and meaning of every member."""
    return table("number | name | meaning", ((m.value, m.name, texts[m]) for m in members))


def bits(prefix: str, texts: dict[str, str]) -> str:
    """Bit, name and meaning of every constant of the process image or link that begins with ``prefix``."""
    return table("bit | name | meaning", ((value.bit_length() - 1, name, text)
                                          for name, text in texts.items()
                                          for value in [_constant(prefix + name)]))  # fmt: skip


def _constant(name: str) -> int:
    for module in (process_image, reference_messages, datagram_layout):
        if hasattr(module, name):
            value = getattr(module, name)
            assert isinstance(value, int)
            return value
    raise LookupError(name)


def session_table(rows: tuple[Row, ...]) -> str:
    """State, event, next state where it is another one, reaction."""
    return table(
        "state | event | next state | sends",
        ((r.state, r.event, "" if r.then == r.state else r.then, r.sends.replace("–", "")) for r in rows),
    )


def group_table() -> str:
    """Every command and reference in every mode of the group: the reason that answers, and the next mode."""
    return table(
        "in | " + " | ".join(COLUMNS.get(asked, asked.name) for asked in Asked),
        (
            [
                mode.name,
                *(
                    t.reason.name if t.mode is mode else f"{t.reason.name}→{t.mode.name}"
                    for t in (ANSWERS[mode, asked] for asked in Asked)
                ),
            ]
            for mode in Mode
        ),
    )


def golden() -> str:
    """One datagram of every kind, byte for byte."""
    return listing(json.loads(GOLDEN.read_text()))


def signed_golden() -> dict[str, bytes]:
    """Some of them signed with the key that the page gives: one of each direction, and HELLO."""
    secret = LinkKey(bytes(range(32)))
    welcome = next(message for message in MESSAGES if isinstance(message, Welcome))
    keys = secret.of_client(welcome.client_nonce, HEADER_SAMPLE.session, welcome.boot_id)
    header = HEADER_SAMPLE._replace(sequence=HEADER_SAMPLE.sequence + (7 << 32))
    signed = {}
    for message in MESSAGES:
        if isinstance(message, Hello):
            signed["Hello"] = encode(message, header._replace(session=0), secret.of_hello())
        elif isinstance(message, Welcome | Heartbeat | ReferencePose | Bye):
            key = keys.receives if isinstance(message, Welcome) else keys.sends
            signed[type(message).__name__] = encode(message, header, key)
    return signed


def listing(datagrams: dict[str, str]) -> str:
    """Hexadecimal datagrams under their names."""
    parts = []
    for name, data in datagrams.items():
        parts.append(f"{name}\n" + textwrap.indent("\n".join(textwrap.wrap(data, 96)), "  "))
    return "```text\n" + "\n".join(parts) + "\n```"


SECTIONS: dict[str, Callable[[], str]] = {
    "header": lambda: datagram_table(HEADER),
    "flags": lambda: bits(
        "FLAG_",
        {
            "ECHO_VALID": "`echo_sequence` holds a number",
            "AUTHENTICATED": "critical: a trailer with a tag follows the payload (clause 11)",
        },
    ),
    "key states": lambda: session_table(KEY_SERVER_ROWS),
    "trailer": lambda: datagram_table(TRAILER),
    "keys": lambda: table("key | label | context | signs", KEY_ROWS),
    "signed golden": lambda: listing({name: data.hex() for name, data in signed_golden().items()}),
    "capabilities": lambda: bits("CAPABILITY_", CAPABILITIES),
    "payloads": payload_tables,
    "limits": limits,
    "motion limits": motion_limits,
    "server states": lambda: session_table(SERVER_ROWS),
    "client states": lambda: session_table(CLIENT_ROWS),
    "kinds": lambda: ", ".join(f"{kind.value} {kind.name}" for kind in Kind) + ".",
    "commands": lambda: enumeration(CommandCode, COMMAND_TEXTS),
    "group states": lambda: enumeration(GroupState, GROUP_STATE_TEXTS),
    "group transitions": group_table,
    "severities": lambda: enumeration(Severity, SEVERITY_TEXTS),
    "reasons": lambda: enumeration(Reason, REASON_TEXTS),
    "faults": lambda: enumeration(FaultCode, FAULT_TEXTS),
    "state flags": lambda: bits(
        "FLAG_",
        {
            "PLANT_LINK_OK": "the fieldbus is healthy",
            "EMERGENCY_LATCHED": "the emergency stop is latched",
            "SETTLED": "the arm has come to rest at its commanded pose",
            "STREAMING": "MOVING means: following streamed references",
        },
    ),
    "inputs": lambda: register_table(INPUT_TABLE),
    "outputs": lambda: register_table(OUTPUT_TABLE),
    "status bits": lambda: bits(
        "STATUS_",
        {
            "SUPPLY_ON": "the pump runs",
            "VALVES_ENABLED": "the valves follow the commands",
            "WATCHDOG_TRIPPED": "the motion watchdog closed the valves; latched",
            "SENSOR_FAULT": "a sensor is known to be wrong",
        },
    ),
    "control bits": lambda: bits(
        "CONTROL_",
        {
            "ENABLE": "the valves may follow the commands",
            "RESET_WATCHDOG": "a rising edge clears WATCHDOG_TRIPPED",
        },
    ),
    "golden": golden,
    "stream limits": stream_limits,
}  # fmt: skip


def rendered(page: str) -> str:
    """``page`` with the content of every generated section made anew."""
    return filled(page, {name: made() for name, made in SECTIONS.items()})


if __name__ == "__main__":
    PAGE.write_text(rendered(PAGE.read_text()))
