"""What is half made when Ctrl-C comes does not stay."""

from pathlib import Path

import pytest

from testbed.reporting.console import nothing_half_made, promised


def test_what_is_half_made_goes_and_what_was_there_stays(tmp_path: Path) -> None:
    made, there = tmp_path / "made", tmp_path / "there"
    there.write_text("of somebody else")
    for target in (made, there):
        with pytest.raises(KeyboardInterrupt), nothing_half_made():  # noqa: PT012  the end raises
            promised(target).write_text("half")
            raise KeyboardInterrupt
    assert not made.exists()
    assert there.exists()
