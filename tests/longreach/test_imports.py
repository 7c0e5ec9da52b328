"""`import longreach` is cheap, and the command says where it does not run."""

import subprocess
import sys

import longreach

CHEAP = """
import sys, longreach
dir(longreach)
print(*{"scipy", "numba", "cv2", "matplotlib", "numpy"} & set(sys.modules))
"""
ELSEWHERE = """
import sys, importlib.metadata
sys.platform = "win32"  # after what the standard library itself decides by it
from longreach.__main__ import main
main()
"""


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *words], capture_output=True, text=True)


def test_what_is_heavy_is_imported_when_it_is_asked_for() -> None:
    assert run("-c", CHEAP).stdout.split() == []


def test_every_name_is_there_and_no_other() -> None:
    assert all(getattr(longreach, name) is not None for name in longreach.__all__)
    assert set(longreach.__all__) <= set(dir(longreach))
    assert not hasattr(longreach, "lock_step")


def test_another_operating_system_is_refused_in_one_line() -> None:
    done = run("-c", ELSEWHERE)
    assert done.returncode == 1
    assert done.stderr == "longreach runs on Linux, this is win32: use the containers (docs/containers.md)\n"
