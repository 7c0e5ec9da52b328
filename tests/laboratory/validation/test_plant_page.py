"""docs/plant.md against the code: families, switches, commands and modules that it names."""

import re
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from laboratory.validation.known_answers import FAMILIES
from plant_emulator.core.layout import N_STATES
from testbed.cli.main import app
from tests.laboratory.validation.test_validation import LEAST_CASES
from tests.plant_emulator.plant_world import CONFIGS
from tests.support.paths import ROOT

PAGE = (ROOT / "docs" / "plant.md").read_text(encoding="utf-8")


def rows(heading: str) -> list[list[str]]:
    """The cells of the first table after ``heading``, without its head."""
    lines = PAGE.split(heading, 1)[1].splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("|"))
    table = []
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        table.append([cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]])
    return table[2:]


def test_families_are_those_of_the_command() -> None:
    named = {int(row[0]): row[1] for row in rows("## Validation")}
    assert named == {number: title for number, (title, _) in FAMILIES.items()}
    counted = {int(row[0]): int(row[2]) for row in rows("## Validation")}
    assert counted == LEAST_CASES
    total = sum(counted.values())
    assert f"{total} of {total} cases in {len(FAMILIES)} families" in PAGE


def test_the_number_of_states_is_right() -> None:
    assert f"of {N_STATES} states" in PAGE


@pytest.mark.parametrize("name", ["plant.yaml", "arms/long_crane/plant.yaml"])
def test_every_switch_is_a_key_of_both_files(name: str) -> None:
    table = rows("What makes rigid-body positioning wrong")
    keys = [key for row in table for key in re.findall(r"`([a-z_.]+)`", row[0])]
    assert len(keys) > 6
    for key in keys:
        place: Any = yaml.safe_load((CONFIGS / name).read_text(encoding="utf-8"))
        for part in key.split("."):
            assert part in place, key
            place = place[part]
        if key.startswith("errors."):
            assert place["enabled"] is True


def test_modules_and_pages_exist() -> None:
    for row in rows("## The model"):
        for module in re.findall(r"`([\w/]+\.py)`", row[3]):
            assert (ROOT / "plant_emulator" / "core" / module).is_file()
    for link in re.findall(r"\]\(([\w/]+\.\w+)\)", PAGE):
        assert (ROOT / "docs" / link).is_file(), link


@pytest.mark.parametrize(
    "command", [["experiment", "validation"], ["experiment", "validation", "--method", "rough"]]
)
def test_commands_exist(command: list[str]) -> None:
    assert f"longreach {' '.join(command)}" in PAGE
    assert CliRunner().invoke(app, [*command, "--help"]).exit_code == 0
