"""Generated tables of the pages on coupler, programs and worlds, and the list of the suites' cases;
``python -m tools.pages`` writes them.
"""

import csv
import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from pymodbus.pdu.bit_message import ReadCoilsRequest
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadWriteMultipleRegistersRequest

from conformance.runner import coupler_cases, reference_cases
from foundation.modbus import MAX_PDU_BYTES
from laboratory.experiments.positioning.worlds import WORLDS
from plant_emulator.core.coupler import modbus_requests as requests
from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.core.coupler.modbus_requests import Span
from plant_emulator.shell.coupler_connection import MAX_WRITE_BITS
from protocol import coupler_registers as registers
from protocol.process_image import INPUT_ADDRESS, INPUT_WORDS, OUTPUT_ADDRESS, OUTPUT_WORDS
from tools.protocol_page import filled
from tools.site import reference
from tools.tables import table
from vision_pc.application.programs import PROGRAMS

DOCS = Path(__file__).parents[1] / "docs"
CASES = DOCS / "protocol" / "cases.csv"
_READ, _BITS, _NONE = ReadHoldingRegistersRequest.MAX_COUNT, ReadCoilsRequest.MAX_COUNT, "–"
_MOST_WORDS = (MAX_PDU_BYTES - 6) // 2  # behind function code, address, quantity and byte count
FUNCTIONS = {
    requests.READ_COILS: ("read digital outputs", _BITS, _NONE),
    requests.READ_DISCRETE: ("read digital inputs", _BITS, _NONE),
    requests.READ_HOLDING: ("read inputs, outputs, own registers", _READ, _NONE),
    requests.READ_INPUT: ("read inputs, own registers", _READ, _NONE),
    requests.WRITE_COIL: ("write a digital output", _NONE, 1),
    requests.WRITE_SINGLE: ("write an output word or own register", _NONE, 1),
    requests.DIAGNOSTICS: ("diagnostics", _NONE, _NONE),
    requests.WRITE_COILS: ("write digital outputs", _NONE, MAX_WRITE_BITS),
    requests.WRITE_MULTIPLE: ("write outputs or own registers", _NONE, _MOST_WORDS),
    requests.READ_WRITE_MULTIPLE: (
        "write outputs, then read",
        _READ,
        ReadWriteMultipleRegistersRequest.MAX_WRITE_COUNT,
    ),
}
EXCEPTIONS = {
    requests.ILLEGAL_FUNCTION: "function code or sub-function that is not served",
    requests.ILLEGAL_ADDRESS: "address",
    requests.ILLEGAL_VALUE: "quantity, length or value",
    requests.WATCHDOG_EXPIRED: "the watchdog has expired, or is active and cannot be set",
    requests.OWNED_BY_ANOTHER: "the outputs belong to another master",
}
DIAGNOSTICS = {
    requests.ECHO: "the same data",
    requests.READ_STATUS: "the status word (3.3)",
    requests.CLEAR_COUNTERS: "clears the counters, the same data",
    requests.COUNT_MESSAGES: "requests received",
    requests.COUNT_FRAMING_ERRORS: "frames that ended a connection (1.4)",
    requests.COUNT_EXCEPTIONS: "exceptions answered",
    requests.COUNT_ADDRESSED: "requests addressed to this coupler: all of them",
}
STATUS = (
    (0, registers.STATUS_TERMINAL_BUS, "terminal bus error (never on this plant)"),
    (1, registers.STATUS_CONFIGURATION, "configuration error (never on this plant)"),
    (15, registers.STATUS_FIELDBUS, "fieldbus error: the watchdog has expired"),
)


def _codes(allowed: dict[int, tuple[Span, ...]], span: Span) -> list[int]:
    """Function codes, those of bits left out, whose blocks hold all of ``span``."""
    bits = (requests.READ_COILS, requests.READ_DISCRETE, requests.WRITE_COIL, requests.WRITE_COILS)
    end = span.address + span.words

    def holds(block: Span) -> bool:
        return block.address <= span.address and end <= block.address + block.words

    return [code for code, blocks in allowed.items() if code not in bits and any(map(holds, blocks))]


def word_codes(address: int, words: int) -> tuple[list[int], list[int]]:
    """The function codes that read and that write these registers."""
    span = Span(address, words)
    return _codes(COUPLER_MAP.reads, span), _codes(COUPLER_MAP.writes, span)


def _block(name: str, address: int, words: int) -> Iterable[object]:
    shown = (", ".join(map(str, codes)) or _NONE for codes in word_codes(address, words))
    return (f"{address:#06x}", words, name, *shown)


def coupler_sections() -> dict[str, str]:
    """Every generated section of the coupler's page by its name."""
    assert set(FUNCTIONS) == set(COUPLER_MAP.reads) | set(COUPLER_MAP.writes) | {requests.DIAGNOSTICS}
    blocks = (
        _block("analog inputs", INPUT_ADDRESS, INPUT_WORDS),
        _block("digital inputs", registers.DIGITAL_INPUT_ADDRESS, registers.DIGITAL_INPUTS // 16),
        _block("analog outputs", OUTPUT_ADDRESS, OUTPUT_WORDS),
        _block("digital outputs", registers.DIGITAL_OUTPUT_ADDRESS, registers.DIGITAL_OUTPUTS // 16),
    )
    own = (
        (*_block(row.name, row.address, row.words), row.unit or _NONE, row.meaning)
        for row in registers.COUPLER_TABLE
    )
    return {
        "functions": table(
            "code | what it does | reads at most | writes at most",
            ((code, *row) for code, row in FUNCTIONS.items()),
        ),
        "exceptions": table("code | what is wrong", EXCEPTIONS.items()),
        "diagnostics": table("sub-function | answer", DIAGNOSTICS.items()),
        "blocks": table("address | words | block | read with | write with", blocks),
        "registers": table("address | words | register | read with | write with | unit | meaning", own),
        "status": table("bit | mask | meaning", ((bit, f"{mask:#06x}", text) for bit, mask, text in STATUS)),
    }


def program_sections() -> dict[str, str]:
    """The table of the programs."""
    rows = (
        (
            f"`{program.name}`",
            program.title,
            f"`{_where(program.core or program.run)}`",
            ", ".join(need.__name__.replace("_", " ") for need in program.needs),
            program.source,
        )
        for program in PROGRAMS
    )
    return {"programs": table("program | what it does | read | needs | source", rows)}


def _where(function: Callable[..., Any]) -> str:
    """The file of a function under vision_pc, and its name."""
    return f"{function.__module__.removeprefix('vision_pc.').replace('.', '/')}.py: {function.__qualname__}"


def world_sections() -> dict[str, str]:
    """The tables of the worlds and their axes."""
    axes = {axis.name: axis for world in WORLDS.values() for axis in world.axes}
    worlds = (
        (f"`{name}`", f"`{world.arm}`", _axes_of([axis.name for axis in world.axes], list(axes)))
        for name, world in WORLDS.items()
    )
    drawn = (f"- **{_words(axis.name)}**: {axis.width}" for axis in axes.values())
    return {
        "worlds": table("world | arm | drawn beside the task and the lab's own", worlds),
        "axes": "\n".join(drawn),
    }


def _axes_of(drawn: list[str], every: list[str]) -> str:
    """What a world draws: its axes, or those that it leaves out, whichever is shorter."""
    left_out = [axis for axis in every if axis not in drawn]
    if not drawn:
        return "nothing more"
    if len(left_out) < len(drawn):
        return f"all axes below but {', '.join(map(_words, left_out))}"
    return ", ".join(map(_words, drawn))


def _words(name: str) -> str:
    return name.replace("_", " ")


PAGES: dict[str, Callable[[], dict[str, str]]] = {
    "process_image.md": coupler_sections,
    "calibration.md": program_sections,
    "worlds.md": world_sections,
}


def _reference(name: str, made: Callable[[], str]) -> Callable[[], dict[str, str]]:
    return lambda: {name: made()}


PAGES |= {
    f"reference/{name}.md": _reference(name, made)
    for name, made in (
        ("configuration", reference.page),
        ("commands", reference.commands_page),
        ("python", reference.python_page),
    )
}


def rendered(page: str) -> str:
    """The text of ``page`` with every generated section made anew."""
    return filled((DOCS / page).read_text(encoding="utf-8"), PAGES[page]())


def cases_csv() -> str:
    """Every case of both suites: number, clause that it cites, whether it moves or writes, question."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("suite", "case", "clause", "moves", "question"))
    for suite, cases in (("reference", reference_cases()), ("coupler", coupler_cases())):
        writer.writerows((suite, c.number, c.clause, "yes" if c.motion else "", c.title) for c in cases)
    return out.getvalue()


if __name__ == "__main__":
    CASES.write_text(cases_csv(), encoding="utf-8")
    for name in PAGES:
        (DOCS / name).write_text(rendered(name), encoding="utf-8")
