"""Incidents of the services: noted in a file that all share, read by one, believed by nobody."""

import json
from pathlib import Path

import pytest

from foundation.incidents import INCIDENTS, IncidentFile, incidents_here, note_incident


def test_what_one_process_notes_another_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(INCIDENTS, str(tmp_path / "incidents"))
    file = incidents_here()
    assert file.newest() == ()
    first = note_incident("plant", "service.crashed", "it fell")
    assert file.newest() == (first,)
    second = note_incident("controller", "service.crashed", "it fell too")
    assert file.newest() == (first, second)


def test_without_the_variable_nothing_is_noted_or_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(INCIDENTS, raising=False)
    assert note_incident("plant", "service.crashed", "it fell").detail == "it fell"
    assert incidents_here().newest() == ()


def test_a_file_that_cannot_be_written_costs_the_note_alone(tmp_path: Path) -> None:
    assert note_incident("plant", "service.crashed", "it fell", tmp_path / "no" / "where").service == "plant"


@pytest.mark.parametrize(
    "line",
    [
        "", "no JSON", "[]", "3", '{"at_s": 1}', '{"at_s": "x", "service": "", "cause": "", "detail": ""}',
        '{"at_s": NaN, "service": "", "cause": "", "detail": ""}',
        '{"at_s": 1e999, "service": 1, "cause": 1, "detail": 1}',
        "\xff",
    ],
)  # fmt: skip
def test_a_line_that_is_no_incident_is_left_out(tmp_path: Path, line: str) -> None:
    path = tmp_path / "incidents"
    path.write_bytes(line.encode("latin-1") + b"\n")
    noted = note_incident("plant", "service.crashed", "it fell", path)
    assert IncidentFile(path).newest() == (noted,)


def test_only_the_newest_are_read_of_a_file_however_long(tmp_path: Path) -> None:
    path = tmp_path / "incidents"
    row = {"at_s": 1.0, "service": "plant", "cause": "service.crashed", "detail": "x" * 3000}
    path.write_text("".join(json.dumps(row | {"at_s": float(k)}) + "\n" for k in range(100)))
    newest = IncidentFile(path).newest()
    assert newest[-1].at_s == 99.0
    assert len(newest) < 20
    assert {len(each.detail) for each in newest} == {400}
