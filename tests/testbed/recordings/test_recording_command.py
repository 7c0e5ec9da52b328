"""`longreach recording`: told in words and figures, also of a file that was cut off."""

import csv
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from foundation.recording.mcap_file import Format, McapFile, Topic
from foundation.recording.messages import format_of
from testbed.cli.main import app
from tests.foundation.recording.test_mcap_file import written
from tests.foundation.recording.test_messages import Reading

UNKNOWN = Format("", "", b"", "bytes")


def asked(*words: object, status: int = 0) -> str:
    """What `longreach recording` prints."""
    done = CliRunner().invoke(app, ["recording", *map(str, words)])
    assert done.exit_code == status, done.output
    return done.output


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """A recording of 40 messages of which a kill left 30."""
    written(tmp_path / "f.mcap", 40)
    whole = (tmp_path / "f.mcap").read_bytes()
    last = whole.rindex(b"zstd", 0, whole.index(b"zstd", len(whole) - 600))  # of the last chunk's head
    (tmp_path / "f.mcap").write_bytes(whole[: last + 20])
    return tmp_path / "f.mcap"


def test_a_cut_recording_is_told_and_made_whole(cut: Path, tmp_path: Path) -> None:
    said = asked("verify", cut, "--json", tmp_path / "told.json", status=1)
    told = json.loads((tmp_path / "told.json").read_text())
    assert f"at byte {told['damages'][0]['offset']}: cut off" in said
    assert (told["messages"], told["complete"], told["whole"]) == (30, False, False)
    assert "30 messages" in asked("recover", cut, "--out", tmp_path / "g.mcap")
    assert "30 messages read; whole" in asked("verify", tmp_path / "g.mcap")
    assert "/a" in (said := asked("info", tmp_path / "g.mcap"))
    assert "session 7" in said


def test_a_table_has_a_row_a_message_and_a_column_a_number(tmp_path: Path) -> None:
    topics = [Topic("/r/s", format_of(Reading), bytes), Topic("/t", UNKNOWN, bytes)]
    file = McapFile(tmp_path / "f.mcap", topics, {})
    file.add(0, Reading(level_m=0.1, row=[1.0, 2.0]).SerializeToString(), 5, 6)
    file.add(0, Reading(count=3).SerializeToString(), 7, 8)
    file.add(1, b"x", 9, 9)
    file.close()
    assert "left out, of an unknown encoding, or whose schema is not whole: /t" in asked(
        "to-csv", tmp_path / "f.mcap", "--out", tmp_path
    )
    with (tmp_path / "r_s.csv").open(newline="") as table:
        first, second = csv.DictReader(table)
    assert first == {
        "log_time_ns": "5", "publish_time_ns": "6", "level_m": "0.1", "row[0]": "1.0", "row[1]": "2.0",
        "count": "",
    }  # fmt: skip
    assert (second["level_m"], second["count"]) == ("", "3")
