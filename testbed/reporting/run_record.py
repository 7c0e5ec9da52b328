"""What made a run: command, code and libraries."""

import importlib.metadata
import platform
import subprocess
import sys
import time
from functools import cache
from pathlib import Path
from typing import Any

_LIBRARIES = (
    "longreach",
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "opencv-python-headless",
    "clarabel",
    "ruckig",
)
_ROOT = Path(__file__).parents[2]


def beginning() -> dict[str, Any]:
    """What is known of a run before anything has run."""
    commit, uncommitted = _commit()
    return {
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "commit": commit,
        "uncommitted": uncommitted,
        "libraries": library_versions(),
    }


@cache
def library_versions() -> dict[str, str]:
    """Name → version of what is installed here."""
    installed = {one.name: one.version for one in importlib.metadata.distributions()}
    return {"python": platform.python_version()} | {
        name: installed[name] for name in _LIBRARIES if name in installed
    }


@cache
def _commit() -> tuple[str, bool]:
    """The commit of the checkout that this runs from, and whether files differ; empty outside of one."""
    if not (_ROOT / ".git").exists():
        return "", False
    status = ["status", "--porcelain", "--untracked-files=no"]
    try:
        commit, changes = (
            subprocess.run(
                ["git", "-C", _ROOT, *words], capture_output=True, text=True, timeout=10.0, check=True
            ).stdout
            for words in (["rev-parse", "HEAD"], status)
        )
    except (OSError, subprocess.SubprocessError):
        return "", False
    return commit.strip(), bool(changes)
