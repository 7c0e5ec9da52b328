"""The wheel and the lock under every Python that is promised: a fresh environment, an empty folder, the demo.

It asks a package index, so it is no part of `make test`: `make pythons`.
"""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

from testbed.realtime.doctor import PYTHONS
from tests.support.paths import ROOT

pytestmark = pytest.mark.experiment


def candidates(version: str) -> Iterator[str]:
    """On the path first, then where pyenv keeps what is not on it."""
    on_path = shutil.which(f"python{version}")
    if on_path:
        yield on_path
    yield from map(str, sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python")))


def interpreter(version: str) -> str | None:
    """The first candidate that starts and is what its name says; a pyenv shim may do neither."""
    asked = "import sys; print('%d.%d' % sys.version_info[:2])"
    for candidate in candidates(version):
        done = subprocess.run([candidate, "-c", asked], capture_output=True, text=True)
        if done.stdout.strip() == version:
            return candidate
    return None


def call(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run([str(part) for part in command], cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


@pytest.mark.parametrize("version", [f"{major}.{minor}" for major, minor in PYTHONS])
def test_the_lock_installs_and_the_demo_ends_at_the_object(version: str, tmp_path: Path) -> None:
    found = interpreter(version)
    if found is None:
        pytest.skip(f"Python {version} is not on this machine: NOT tried with it")
    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path / "dist"))
    call(found, "-m", "venv", tmp_path / "fresh", cwd=tmp_path)
    python = tmp_path / "fresh" / "bin" / "python"
    lock = ROOT / "requirements.lock"
    call(python, "-m", "pip", "install", "--quiet", "--no-deps", "--require-hashes", "-r", lock, cwd=tmp_path)
    call(python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel, cwd=tmp_path)
    (tmp_path / "empty").mkdir()
    printed = call(python.parent / "longreach", "demo", "--lockstep", "--seed", "1", cwd=tmp_path / "empty")
    (verdict,) = [line for line in printed.splitlines() if line.startswith("true error after look 1")]
    print(f"Python {version}: {verdict}")
    assert "within ±5 mm in x and y" in verdict
