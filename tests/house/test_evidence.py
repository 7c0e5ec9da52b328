"""Rows of results: their commands can be given as they stand, and README tells what the evidence has."""

import re
import shlex
from typing import Any

import pytest

from laboratory import command
from laboratory.campaigns import experiment
from laboratory.experiments.catalogue import CATALOGUE
from tests.support.paths import ROOT

EVIDENCE = (ROOT / "docs" / "evidence.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Results")[2].partition("\n## ")[0]
FIGURES = re.compile(r"\d+\.\d+(?:, \d+\.\d+)+")


def rows(page: str) -> list[list[str]]:
    """The cells of every row of a page's tables, without their headings."""
    lines = [line for line in page.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if row[0].strip("-: ") not in ("", "what", "what (emulated)")]


def commands() -> list[str]:
    """Every command of the evidence; what another begins with stands for ``…``."""
    found: list[str] = []
    for quoted in re.findall(r"`([^`]+)`", "\n".join("|".join(row) for row in rows(EVIDENCE))):
        if quoted.startswith("…"):
            quoted = found[-1].split(" --")[0] + quoted[1:]
        if quoted.split(" ")[0] in CATALOGUE:
            found.append(quoted)
    return found


@pytest.mark.parametrize("line", commands())
def test_a_command_of_the_evidence_can_be_given(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its options are known, its machines exist, and it has something to run."""
    begun: list[Any] = []

    def perform(chosen: Any, request: Any, settings: Any) -> bool:
        begun.extend(chosen.tasks(request, settings))
        return True

    monkeypatch.setattr(experiment, "perform", perform)
    monkeypatch.chdir(ROOT)
    name, *options = shlex.split(line)
    command._loaded(name).main(options, standalone_mode=False)
    assert begun


def test_the_readme_tells_the_newest_rows_of_the_evidence() -> None:
    """Median and 95 % of each row stand there; where a limit is not met, so does that."""
    told = rows(README)
    assert len(told) >= 4
    for row in told:
        for figures in FIGURES.findall(" ".join(row)):
            sources = [source for source in rows(EVIDENCE) if figures in " ".join(source)]
            assert sources, f"{figures} is in no row of the evidence"
            missed = {"NOT met" in " ".join(source) for source in sources}
            assert ("NOT met" in " ".join(row)) in missed, row
