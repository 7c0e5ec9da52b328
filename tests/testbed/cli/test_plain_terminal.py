"""Terminals and logs that cannot show every letter: a sign stands in its place."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow("starts the command")
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_letter_that_cannot_be_shown_is_no_failure(tmp_path: Path, encoding: str) -> None:
    directory = tmp_path / "20260101-000000"
    directory.mkdir()
    (directory / "run.json").write_text(json.dumps({"command": ["longreach", "demo"], "ended_by": "…–µ"}))
    words = [sys.executable, "-m", "testbed.cli", "runs", "list", "--out", str(tmp_path)]
    done = subprocess.run(words, env={**os.environ, "PYTHONIOENCODING": encoding}, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"?" in done.stdout
    assert b"longreach demo" in done.stdout
