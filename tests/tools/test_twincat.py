"""The files for TwinCAT: nothing is lost on the way, and another parser reads them."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from structured_text.checker import check
from structured_text.parser import Parser
from tests.support.paths import ROOT
from tools.twincat import PlcObject, objects, write

LARGE = 3000  # bytes: a larger file takes that parser seconds, the constants four minutes; read once by hand
ENDS = {"FUNCTION_BLOCK": "END_FUNCTION_BLOCK", "FUNCTION": "END_FUNCTION", "PROGRAM": "END_PROGRAM"}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[PlcObject]]:
    directory = tmp_path_factory.mktemp("twincat")
    return directory, write(directory)


def text_of(file: Path) -> str:
    """What a file declares and does, as one text again."""
    root = ET.parse(file).getroot()
    declared, done = root.findtext(".//Declaration") or "", root.findtext(".//ST")
    if done is None:
        return declared
    begins = next(word for line in declared.splitlines() for word in ENDS if line.startswith(f"{word} "))
    return f"{declared}{done}{ENDS[begins]}\n"


def test_all_files_together_are_the_whole_program(written: tuple[Path, list[PlcObject]]) -> None:
    directory, made = written
    files = sorted(directory.rglob("*.Tc*"))
    assert len({each.file for each in made}) == len(made) == len(files) > 200
    # What stands around the program calls TwinCAT's own libraries: blark alone reads that.
    around = {each.name for each in objects("adapters", (ROOT / "plc/twincat/adapters.st").read_text())}
    own = [file for file in files if file.stem not in around]
    assert len(files) - len(own) == len(around) > 5
    parsed = [each for file in own for each in Parser(file.name, text_of(file)).declarations()]
    names = check(parsed)
    assert "PRG_LR_CONTROLLER" in names.units
    project = (directory / "Longreach.plcproj").read_text(encoding="utf-8")
    assert all(each.file.replace("/", "\\") in project for each in made)


def test_a_changed_text_keeps_its_identifiers() -> None:
    text = "(* why *)\nFUNCTION F_One : INT\nVAR\n    i : INT;\nEND_VAR\nF_One := %d;\nEND_FUNCTION\n"
    (before,), (after,) = (list(objects("one", text % number)) for number in (1, 2))
    assert before.xml != after.xml
    assert before.xml.replace("F_One := 1", "F_One := 2") == after.xml
    assert before.declaration.startswith("(* why *)\nFUNCTION F_One")


@pytest.mark.timeout(900)
@pytest.mark.slow("another parser reads two hundred files")
def test_blark_reads_every_file_but_the_large_ones(written: tuple[Path, list[PlcObject]]) -> None:
    blark = pytest.importorskip("blark.parse", reason="blark is absent: make peers")
    files = [file for file in written[0].rglob("*.Tc*") if file.stat().st_size < LARGE]
    assert len(files) > 200
    for file in sorted(files):
        found = list(blark.parse(file))
        assert found, file.name
        assert [each.exception for each in found if each.exception is not None] == [], file.name
