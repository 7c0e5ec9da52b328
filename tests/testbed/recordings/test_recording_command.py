"""`longreach recording`: told in words and figures, also of a file that was cut off."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.cli.main import app
from tests.foundation.recording.test_mcap_file import written


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


def test_a_cut_recording_is_told(cut: Path, tmp_path: Path) -> None:
    said = asked("info", cut, "--json", tmp_path / "told.json", status=1)
    told = json.loads((tmp_path / "told.json").read_text())
    assert f"at byte {told['damages'][0]['offset']}: cut off" in said
    assert (told["messages"], told["complete"], told["whole"]) == (30, False, False)
    assert "/a" in said
    assert "session 7" in said
