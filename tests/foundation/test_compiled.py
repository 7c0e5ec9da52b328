"""The cache of compiled kernels: fresh after every edit that a kernel can see, and after no other."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from foundation.compiled import KEYS_KEPT, OUR_PACKAGES, sources

pytestmark = pytest.mark.slow("new interpreters compile kernels")

ROOT = Path(__file__).parents[2]

# `made` is a package of three rooms: a kernel, a constant in a file below it, a file that no kernel imports.
MADE = {
    "__init__.py": "",
    "caller.py": (
        "from foundation.compiled import kernel\n"
        "from made.callee import lifted\n\n"
        "@kernel\ndef answer(x):\n    return lifted(x) + 1.0\n"
    ),
    "callee.py": (
        "from foundation.compiled import kernel\n"
        "from made import constants\n\n"
        "@kernel\ndef lifted(x):\n    return constants.FACTOR * x\n"
    ),
    "constants.py": "FACTOR = 2.0\n",
    "stranger.py": "import json\n",
}
RUN = """
from made.caller import answer
print(answer(10.0), sum(answer.stats.cache_hits.values()), sum(answer.stats.cache_misses.values()))
"""


@pytest.fixture
def made(tmp_path: Path) -> Path:
    package = tmp_path / "house" / "made"
    package.mkdir(parents=True)
    for name, text in MADE.items():
        (package / name).write_text(text)
    return package


def started(made: Path, script: str = RUN, cache: Path | None = None) -> subprocess.Popen[str]:
    path = f"{made.parent}{os.pathsep}{ROOT}"
    environment = {
        **os.environ,
        "PYTHONPATH": path,
        "NUMBA_CACHE_DIR": str(cache or made.parents[1] / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",  # two edits within a second would look alike to Python's own cache
    }
    return subprocess.Popen(
        [sys.executable, "-c", script],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def said(process: subprocess.Popen[str]) -> tuple[float, ...]:
    """The numbers that the process printed; it must end well."""
    out, err = process.communicate(timeout=100)
    assert process.returncode == 0, err
    return tuple(map(float, out.split()))


def test_an_edit_in_a_file_that_the_kernel_calls_into_is_seen(made: Path) -> None:
    assert said(started(made)) == (21.0, 0.0, 1.0)
    assert said(started(made)) == (21.0, 1.0, 0.0)
    text = MADE["callee.py"].replace("constants.FACTOR * x", "constants.FACTOR * x + 5.0")
    (made / "callee.py").write_text(text)
    assert said(started(made)) == (26.0, 0.0, 1.0)
    (made / "constants.py").write_text("FACTOR = 3.0\n")
    assert said(started(made)) == (36.0, 0.0, 1.0)
    (made / "stranger.py").write_text("import math\n")
    assert said(started(made)) == (36.0, 1.0, 0.0)
    (made / "constants.py").write_text("FACTOR = 2.0\n")  # an edit taken back finds what it left
    assert said(started(made)) == (26.0, 1.0, 0.0)


def test_processes_that_compile_at_once_do_not_spoil_each_others_cache(made: Path) -> None:
    value = "import numpy\nfrom made.caller import answer\nprint(answer({}))"
    kinds = [f"numpy.{kind}(10)" for kind in ("float32", "float64", "int64", "uint8")]
    scripts = [value.format(kind) for kind in kinds]
    together = [started(made, script) for script in scripts]
    ended = [process.communicate(timeout=100) for process in together]
    assert [out.split() for out, _ in ended] == [["21.0"]] * 4, ended
    again = "\n".join(f"assert answer({kind}) == 21.0" for kind in kinds)
    again = f"import numpy\nfrom made.caller import answer\n{again}"
    counts = "print(sum(answer.stats.cache_hits.values()), sum(answer.stats.cache_misses.values()))"
    assert said(started(made, f"{again}\n{counts}")) == (
        4.0,
        0.0,
    )


def test_old_keys_are_removed(made: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    cache.mkdir()
    for age in range(KEYS_KEPT + 3):
        old = cache / f"made.caller-{age:020d}"
        old.mkdir()
        os.utime(old, (1e9 - age, 1e9 - age))
    other = cache / "made.caller_too-1"
    other.mkdir()
    said(started(made))
    kept = sorted(path.name for path in cache.glob("made.caller-*"))
    assert len(kept) == KEYS_KEPT
    assert kept[: KEYS_KEPT - 1] == [f"made.caller-{age:020d}" for age in range(KEYS_KEPT - 1)]
    assert other.exists()


def test_a_cache_that_cannot_be_made_costs_time_and_a_warning(made: Path, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file where the directory should be")
    process = started(made, cache=taken)
    out, err = process.communicate(timeout=100)
    assert out.split() == ["21.0", "0", "1"]
    assert err.count("compiled kernels are not kept") == 1


@pytest.mark.parametrize("disabled", ["0", "1"])
def test_a_settled_kernel_says_the_same(made: Path, monkeypatch: pytest.MonkeyPatch, disabled: str) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", disabled)
    script = """
from foundation.compiled import settled
from made.caller import answer
once = settled(answer, 1.0)
print(once(10.0), once(20.0), answer(10.0))
"""
    assert said(started(made, script)) == (21.0, 41.0, 21.0)


def test_relative_imports_and_packages_are_followed(tmp_path: Path) -> None:
    for name, text in {
        "made/__init__.py": "from made import base\n",
        "made/base.py": "",
        "made/room/__init__.py": "from . import below\n",
        "made/room/below.py": "from .. import far\nimport numpy\n",
        "made/room/kernels.py": "def late():\n    from ..other import thing\n",
        "made/other.py": "",
        "made/far.py": "",
        "made/stranger.py": "",
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = sources(tmp_path / "made" / "room" / "kernels.py")
    rooms = {"made.room", "made.room.below", "made.room.kernels"}
    assert set(found) == {"made", "made.base", "made.far", "made.other"} | rooms


def test_our_packages_are_those_that_are_installed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    shipped = set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"])
    assert shipped | {"laboratory"} == OUR_PACKAGES  # which is a distribution of its own


def test_every_kernel_is_compiled_here() -> None:
    for package in OUR_PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            names = {
                name
                for node in ast.walk(ast.parse(path.read_text()))
                if isinstance(node, ast.Attribute | ast.Name)
                for name in [node.attr if isinstance(node, ast.Attribute) else node.id]
            }
            if path != ROOT / "foundation" / "compiled.py":
                assert not names & {"njit", "jit", "vectorize", "guvectorize"}, path


def test_without_a_home_nothing_is_kept_and_nothing_is_left_behind(tmp_path: Path) -> None:
    """A user without a name, as in many containers: `~` is no directory."""
    code = "from foundation.compiled import cache_root; print(cache_root())"
    known = {"PATH": os.environ["PATH"], "HOME": "~", "PYTHONPATH": str(Path(__file__).parents[2])}
    made = [
        subprocess.run(
            [sys.executable, "-c", code], env=known | more, cwd=tmp_path, capture_output=True, text=True
        )
        for more in ({}, {"XDG_CACHE_HOME": "/var/cache/mine"})
    ]
    assert [each.stdout.strip() for each in made] == ["None", "/var/cache/mine/longreach/kernels"]
    assert list(tmp_path.iterdir()) == []
