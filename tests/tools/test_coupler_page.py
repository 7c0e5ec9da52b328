"""docs/process_image.md against the code, and the code against the published facts."""

import itertools
import re

from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.shell.modbus_pdus import request_of
from tools.coupler_page import DIAGNOSTICS, PAGE, rendered, sections

TEXT = PAGE.read_text()


def test_the_tables_are_those_of_the_code() -> None:
    assert rendered(TEXT) == TEXT, "run: python -m tools.coupler_page"
    assert set(re.findall(r"<!-- generated: ([a-z]+) -->", TEXT)) == set(sections())


def test_clauses_are_numbered_in_order_and_those_cited_exist() -> None:
    clauses = [tuple(map(int, c.split("."))) for c in re.findall(r"^\*\*(\d+\.\d+)\*\*", TEXT, re.MULTILINE)]
    for (major, minor), (next_major, next_minor) in itertools.pairwise(clauses):
        assert (next_major, next_minor) in ((major, minor + 1), (major + 1, 1))
    cited = re.findall(r"\((\d+\.\d+)\)", TEXT)
    assert {tuple(map(int, c.split("."))) for c in cited} <= set(clauses)


def test_the_page_s_diagnostics_are_those_served() -> None:
    asked = {sub: request_of(bytes([8, 0, sub, 0, 0])) for sub in range(256)}
    served = {sub for sub, request in asked.items() if COUPLER_MAP.exception_for(request) == 0}
    assert served == set(DIAGNOSTICS)
