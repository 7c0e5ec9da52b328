"""Rerun's command line, an independent reader of recordings, where it is installed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

_PLACES = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)))
RERUN = shutil.which("rerun", path=_PLACES)  # a test need not run with the environment's folder on the path
needs_rerun = pytest.mark.skipif(RERUN is None, reason="rerun is not installed: make peers")


def rerun(home: Path, *words: Any) -> str:
    """What its command line says; without a ``home`` of its own it would set up telemetry."""
    command = [str(RERUN), *map(str, words)]
    environment = {"HOME": str(home), "PATH": os.defpath}
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=120.0, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr
