"""docs/calibration.md's table of programs is the table that runs."""

from tests.support.paths import ROOT
from tools.programs_page import PAGE, rendered
from vision_pc.application.programs import PROGRAMS

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_table_is_that_of_the_code() -> None:
    assert rendered(TEXT) == TEXT, "run: python -m tools.programs_page"
    assert all(f"| `{program.name}` |" in TEXT for program in PROGRAMS)


def test_every_source_in_this_repository_is_there() -> None:
    inside = {program.source for program in PROGRAMS if program.source.startswith("docs/")}
    assert inside
    assert all((ROOT / source).is_file() for source in inside)
