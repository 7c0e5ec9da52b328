"""docs/how_to/add_an_experiment.md does what it says: its experiment is run, judged, and resumed."""

import importlib
import re
import sys
from pathlib import Path

import pytest

from laboratory.campaigns.experiment import perform
from tests.support.pages import page
from tests.support.paths import CONFIGS

BLOCKS = re.findall(r"```python\n(.*?)```", page("how_to/add_an_experiment.md"), re.DOTALL)


def test_the_page_s_experiment_is_run_judged_and_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sag_of_the_page.py").write_text(BLOCKS[0], encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").symlink_to(CONFIGS)
    sag = importlib.import_module("sag_of_the_page")
    try:
        for reused in (0, 4):
            done = dict(vars(sag)) | {"perform": perform}
            exec(BLOCKS[1], done)
            shown = capsys.readouterr().out
            assert done["passed"], shown
            assert "worst sag" in shown
            assert f"{reused} rows reused" in " ".join(shown.split())
    finally:
        del sys.modules["sag_of_the_page"]
