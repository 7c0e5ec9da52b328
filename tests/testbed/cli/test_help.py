"""Help without what is heavy, and how much a command says."""

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.cli.main import app

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


def test_no_help_imports_what_is_heavy() -> None:
    subprocess.run([sys.executable, "-c", SHOWN], check=True, timeout=100)


def test_quiet_gives_results_alone_and_verbose_says_where(tmp_path: Path) -> None:
    words = ["experiment", "hua", "--method", "stress", "--count", "1", "--workers", "0"]
    words += ["--out", str(tmp_path / "rows"), "--json", str(tmp_path / "figures.json")]
    assert "figures written to" in CliRunner().invoke(app, words).stdout
    assert "figures written to" not in CliRunner().invoke(app, [*words, "-q"]).stdout
    wrong = ["arm", "check", "nosuch"]
    assert "Traceback" in CliRunner().invoke(app, [*wrong, "-v"]).stderr
    assert "Traceback" not in CliRunner().invoke(app, wrong).stderr
