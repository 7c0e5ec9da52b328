"""Terminals and logs that cannot show every letter: a sign stands in its place."""

import os
import subprocess
import sys

import pytest


@pytest.mark.slow("starts the command")
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_letter_that_cannot_be_shown_is_no_failure(encoding: str) -> None:
    words = [sys.executable, "-m", "longreach", "markers", "--help"]
    done = subprocess.run(words, env={**os.environ, "PYTHONIOENCODING": encoding}, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"PICTURE?" in done.stdout
