"""Generated pages and carried libraries are current."""

import hashlib
import itertools
import re
from pathlib import Path

import pytest

from plant_emulator.core.coupler import modbus_requests as modbus
from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.shell.modbus_pdu import request_of
from protocol.coupler_registers import COUPLER_TABLE
from tests.support.pages import page, table_below
from tests.support.paths import ROOT
from tools import pages
from vision_pc.application.programs import PROGRAMS

VENDOR = [
    ROOT / "vision_pc" / "shell" / "rest" / "console" / "page" / "vendor",
    ROOT / "foundation" / "rest" / "docs" / "vendor",
]


@pytest.mark.parametrize("name", pages.PAGES)
def test_the_tables_are_those_of_the_code(name: str) -> None:
    assert pages.rendered(name) == page(name), "run: python -m tools.pages"
    assert set(re.findall(r"<!-- generated: ([\w/ ]+) -->", page(name))) == set(pages.PAGES[name]())


@pytest.mark.parametrize("name", ["process_image.md", "protocol.md"])
def test_clauses_are_numbered_in_order_and_those_cited_exist(name: str) -> None:
    text = page(name)
    clauses = [tuple(map(int, c.split("."))) for c in re.findall(r"^\*\*(\d+\.\d+)\*\*", text, re.MULTILINE)]
    for (major, minor), following in itertools.pairwise(clauses):
        assert following in ((major, minor + 1), (major + 1, 1))
    cited = re.findall(r"\((?:see )?(\d+\.\d+)\)", text)
    assert {tuple(map(int, c.split("."))) for c in cited} <= set(clauses)


COUPLER = page("process_image.md")
BITS = {modbus.READ_COILS, modbus.READ_DISCRETE, modbus.WRITE_COIL, modbus.WRITE_COILS}


def cells(table: str) -> list[list[str]]:
    """The cells of a table of the coupler's page."""
    return table_below(COUPLER, f"<!-- table: {table} -->")


def test_the_page_s_functions_and_diagnostics_are_those_served() -> None:
    served = {*COUPLER_MAP.reads, *COUPLER_MAP.writes, modbus.DIAGNOSTICS}
    assert {int(code) for code, *_ in cells("functions")} == served
    asked = {sub: request_of(bytes([8, 0, sub, 0, 0])) for sub in range(256)}
    answered = {sub for sub, request in asked.items() if COUPLER_MAP.exception_for(request) == 0}
    assert {int(sub) for sub, _ in cells("diagnostics")} == answered


def test_the_page_s_registers_are_those_of_the_table_with_their_function_codes() -> None:
    rows = cells("registers")
    written = [(int(at, 16), int(words), name, meaning) for at, words, name, *_, meaning in rows]
    assert written == [(row.address, row.words, row.name, row.meaning) for row in COUPLER_TABLE]
    for address, words, _, *shown in (*(row[:5] for row in rows), *cells("blocks")):
        begin, end = int(address, 16), int(address, 16) + int(words)
        for codes, allowed in zip(shown, (COUPLER_MAP.reads, COUPLER_MAP.writes), strict=True):
            blocks = [(code, span) for code, spans in allowed.items() for span in spans if code not in BITS]
            holding = {code for code, at in blocks if at.address <= begin and end <= at.address + at.words}
            assert set(map(int, re.findall(r"\d+", codes))) == holding, address


def test_every_program_has_its_row_and_its_source() -> None:
    text = page("calibration.md")
    assert all(f"| `{program.name}` |" in text for program in PROGRAMS)
    inside = {program.source for program in PROGRAMS if program.source.startswith("docs/")}
    assert inside
    assert all((ROOT / source).is_file() for source in inside)


@pytest.mark.parametrize("folder", VENDOR, ids=lambda folder: folder.parts[-4])
def test_every_carried_file_has_its_version_licence_and_hash(folder: Path) -> None:
    told = (folder / "THIRD_PARTY.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\S+) \| (\S+) \S+ \| \S+ \| ([0-9a-f]{64}) \|$", told, re.MULTILINE)
    assert {path.name for path in folder.iterdir()} == {name for name, *_ in rows} | {"THIRD_PARTY.md"}
    for name, package, digest in rows:
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name
        assert f"## {package}\n\n```" in told, "the licence's text"
