"""Generated pages and carried libraries are current."""

import hashlib
import itertools
import re

import pytest

from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.shell.coupler_connection import request_of
from tests.support.paths import ROOT
from tools import against_reality_page, pages
from tools.page_vendor import FILES, PACKAGES, Made
from vision_pc.application.programs import PROGRAMS

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


def test_the_page_shows_what_is_measured_now() -> None:
    for row in against_reality_page.of_parts():
        assert f"| {row.ours} | {row.verdict} |" in against_reality_page.PAGE.read_text(encoding="utf-8"), (
            "run: python -m tools.against_reality_page"
        )


def test_a_later_valve_makes_a_later_joint_by_as_much() -> None:
    late = (
        against_reality_page.stepped(0, 0.4, "plant.valves.delay_ms=50.0").delay_s
        - against_reality_page.stepped(0, 0.4).delay_s
    )
    assert late == pytest.approx(0.049, abs=0.003)


@pytest.mark.parametrize("made", FILES, ids=lambda made: made.name)
def test_a_file_is_what_its_page_says(made: Made) -> None:
    told = (made.folder / "THIRD_PARTY.md").read_text(encoding="utf-8")
    expected = rf"^\| {re.escape(made.name)} \| (\S+) (\S+) \| (\S+) \| ([0-9a-f]{{64}}) \|$"
    row = re.search(expected, told, re.MULTILINE)
    assert row is not None
    package = PACKAGES[made.package]
    assert row.groups()[:3] == (package.name, package.version, package.licence)
    assert hashlib.sha256((made.folder / made.name).read_bytes()).hexdigest() == row[4]
    assert f"## {package.name}\n\n```" in told  # the licence's text


def test_every_file_of_a_vendor_folder_is_made_by_the_recipe() -> None:
    for folder in {made.folder for made in FILES}:
        made = {each.name for each in FILES if each.folder == folder}
        assert {path.name for path in folder.iterdir()} == made | {"THIRD_PARTY.md"}
