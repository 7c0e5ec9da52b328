"""The commands of a guided session, as the page has them, against a running testbed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.support.page_runner import shell_blocks, up

pytestmark = [pytest.mark.processes, pytest.mark.slow("some twenty motions"), pytest.mark.timeout(1800)]


def test_a_session_runs_loses_a_sample_goes_on_and_is_exported(tmp_path: Path) -> None:
    (block,) = (
        block for block in shell_blocks("hand_eye.md") if block.startswith("longreach hand-eye session run")
    )
    run, show, remove, export = (line.split("#")[0].split() for line in block.splitlines())
    assert remove[-1] == "3"
    with up(tmp_path, "--scenario", "hand_eye") as (rest, _):

        def shown(words: list[str]) -> str:
            done = subprocess.run(
                [sys.executable, "-m", *words], cwd=tmp_path, env=os.environ | {"LONGREACH_URL": rest},
                capture_output=True, text=True, timeout=1500.0, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stdout + done.stderr
            return done.stdout

        assert httpx.post(f"{rest}/enable", timeout=60.0).is_success
        assert "proven global" in shown([*run, "--poses", "6"])
        shown(remove)
        assert "5/6 samples" in shown(show)
        assert "6/6 samples" in shown(run)
        shown(export)
    samples = json.loads((tmp_path / export[-1]).read_text())["samples"]
    assert len(samples) == 6
    assert "3" not in {sample["name"] for sample in samples}
