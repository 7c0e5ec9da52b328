"""`longreach recording`: told in words and figures, also of a file that was cut off."""

import json
from pathlib import Path

from tests.foundation.recording.test_mcap_file import written
from tests.support.commands import ran


def test_a_cut_recording_is_told(tmp_path: Path) -> None:
    """Of 40 messages of which a kill left 30."""
    cut = tmp_path / "f.mcap"
    written(cut, 40)
    whole = cut.read_bytes()
    last = whole.rindex(b"zstd", 0, whole.index(b"zstd", len(whole) - 600))  # of the last chunk's head
    cut.write_bytes(whole[: last + 20])
    said = ran("recording", "info", cut, "--json", tmp_path / "told.json", status=1).output
    told = json.loads((tmp_path / "told.json").read_text())
    assert f"at byte {told['damages'][0]['offset']}: cut off" in said
    assert (told["messages"], told["complete"], told["whole"]) == (30, False, False)
    assert "/a" in said
    assert "session 7" in said
