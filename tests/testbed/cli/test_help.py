"""Help and completion: in the order of use, and without what is heavy."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from testbed.cli.main import app
from testbed.cli.root import PANELS

pytestmark = pytest.mark.slow("new interpreters, one a command")

HEAVY = ("numpy", "scipy", "numba", "cv2", "matplotlib", "distributed", "fastapi", "httpx", "mcap")
SHOWN = f"""
import sys
from typer.testing import CliRunner
from testbed.cli.main import app
from testbed.cli.root import PANELS
for words in ([], *([name] for names in PANELS.values() for name in names)):
    assert CliRunner().invoke(app, [*words, "--help"]).exit_code == 0, words
    assert not [name for name in {HEAVY} if name in sys.modules], words
"""
COMPLETED = "import sys; sys.argv[0] = 'longreach'; from testbed.cli.main import main; main()"


def test_no_help_imports_what_is_heavy() -> None:
    subprocess.run([sys.executable, "-c", SHOWN], check=True, timeout=100)


def test_every_command_is_in_the_order_of_use() -> None:
    root = typer.main.get_command(app)
    names = root.list_commands(typer.Context(root))  # type: ignore[attr-defined]
    assert names == [name for panel in PANELS.values() for name in panel]
    assert names.index("demo") == 0
    assert names.index("conformance") > names.index("camera")


def test_quiet_gives_results_alone_and_verbose_says_where(tmp_path: Path) -> None:
    words = ["experiment", "hua", "--method", "stress", "--count", "1", "--workers", "0"]
    words += ["--out", str(tmp_path / "rows"), "--json", str(tmp_path / "figures.json")]
    assert "figures written to" in CliRunner().invoke(app, words).stdout
    assert "figures written to" not in CliRunner().invoke(app, [*words, "-q"]).stdout
    wrong = ["arm", "check", "nosuch"]
    assert "Traceback" in CliRunner().invoke(app, [*wrong, "-v"]).stderr
    assert "Traceback" not in CliRunner().invoke(app, wrong).stderr


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("longreach dem", ["demo"]),
        ("longreach experiment pos", ["positioning"]),
        ("longreach camera c", ["check", "calibrate", "convert"]),
        ("longreach demo --se", ["--seed", "--set"]),
    ],
)
def test_the_shell_completes(typed: str, offered: list[str]) -> None:
    asked = {"_LONGREACH_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    command = [sys.executable, "-c", COMPLETED]
    done = subprocess.run(command, env={**os.environ, **asked}, capture_output=True, text=True, timeout=100)
    assert sorted(done.stdout.split()) == sorted(offered), done.stderr
