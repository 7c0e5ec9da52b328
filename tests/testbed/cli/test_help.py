"""Help and completion: in the order of use, the same before and after loading, and without what is heavy."""

import os
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from testbed.cli.experiment import ExperimentGroup
from testbed.cli.main import app
from testbed.cli.root import LATER, PANELS
from testbed.experiments.catalogue import OURS

pytestmark = pytest.mark.long

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


@pytest.mark.parametrize("name", LATER)
def test_what_the_list_tells_is_what_the_command_says(name: str) -> None:
    assert LATER[name].told == LATER[name].load().help.partition("\n")[0]


def test_every_command_is_in_the_order_of_use() -> None:
    root = typer.main.get_command(app)
    names = root.list_commands(typer.Context(root))  # type: ignore[attr-defined]
    assert names == [name for panel in PANELS.values() for name in panel]
    assert names.index("demo") == 0
    assert names.index("sniff") > names.index("camera")


def test_experiments_are_listed_with_what_they_show_and_cost() -> None:
    shown = CliRunner().invoke(app, ["experiment", "--help"], terminal_width=200).output
    assert all(name in shown for name in OURS)
    assert ExperimentGroup().later["parking"].endswith("(60 to 90 CPU s of ten minutes a run)")


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("longreach dem", ["demo"]),
        ("longreach experiment plant", ["plant-campaign"]),
        ("longreach camera c", ["check", "calibrate", "convert"]),
        ("longreach demo --se", ["--seed", "--set"]),
    ],
)
def test_the_shell_completes(typed: str, offered: list[str]) -> None:
    asked = {"_LONGREACH_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    command = [sys.executable, "-c", COMPLETED]
    done = subprocess.run(command, env={**os.environ, **asked}, capture_output=True, text=True, timeout=100)
    assert sorted(done.stdout.split()) == sorted(offered), done.stderr
