"""Generated pages and carried libraries are current."""

import hashlib
import itertools
import re
from pathlib import Path

import pytest

from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.shell.coupler_connection import request_of
from tests.support.paths import ROOT
from tools import pages
from vision_pc.application.programs import PROGRAMS

VENDOR = [
    ROOT / "vision_pc" / "shell" / "rest" / "console" / "page" / "vendor",
    ROOT / "foundation" / "rest" / "docs" / "vendor",
]
COUPLER = (pages.DOCS / "process_image.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", pages.PAGES)
def test_the_tables_are_those_of_the_code(page: str) -> None:
    assert pages.rendered(page) == (pages.DOCS / page).read_text(encoding="utf-8"), (
        "run: python -m tools.pages"
    )


def test_every_generated_part_of_the_coupler_s_page_is_there() -> None:
    assert set(re.findall(r"<!-- generated: ([a-z]+) -->", COUPLER)) == set(pages.coupler_sections())


def test_clauses_are_numbered_in_order_and_those_cited_exist() -> None:
    clauses = [
        tuple(map(int, c.split("."))) for c in re.findall(r"^\*\*(\d+\.\d+)\*\*", COUPLER, re.MULTILINE)
    ]
    for (major, minor), (next_major, next_minor) in itertools.pairwise(clauses):
        assert (next_major, next_minor) in ((major, minor + 1), (major + 1, 1))
    cited = re.findall(r"\((\d+\.\d+)\)", COUPLER)
    assert {tuple(map(int, c.split("."))) for c in cited} <= set(clauses)


def test_the_page_s_diagnostics_are_those_served() -> None:
    asked = {sub: request_of(bytes([8, 0, sub, 0, 0])) for sub in range(256)}
    served = {sub for sub, request in asked.items() if COUPLER_MAP.exception_for(request) == 0}
    assert served == set(pages.DIAGNOSTICS)


def test_every_program_has_its_row_and_its_source() -> None:
    text = (pages.DOCS / "calibration.md").read_text(encoding="utf-8")
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
