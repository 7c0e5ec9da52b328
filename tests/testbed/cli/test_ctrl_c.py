"""What is half made when Ctrl-C comes does not stay."""

from pathlib import Path

import pytest

from longreach.__main__ import main
from testbed.cli import main as commands
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


def test_ctrl_c_before_a_command_runs_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def importing() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "main", importing)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "longreach: ended by Ctrl-C\n"
