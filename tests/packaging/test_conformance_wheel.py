"""The suites' own wheel, installed with what it names and nothing else, asks a controller."""

import importlib.metadata
import re
import subprocess
import venv
import zipfile
from collections.abc import Iterable
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement

from tests.conformance.controllers import ControllerUnderTest
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow("a wheel is built and installed, and a suite runs from it")


def required(names: Iterable[str]) -> set[str]:
    """These distributions and all that they need, by the names of what is installed here."""
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop().lower()
        if name not in found:
            found.add(name)
            needed = map(Requirement, importlib.metadata.requires(name) or [])
            waiting += [e.name for e in needed if not e.marker or e.marker.evaluate({"extra": ""})]
    return found


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment that has the wheel and what it demands; no registry is asked."""
    folder = tmp_path_factory.mktemp("alone")
    (built,) = WheelBuilder(str(ROOT / "conformance")).build(directory=str(folder / "dist"))
    venv.create(folder / "venv", with_pip=False, symlinks=True)
    site = next(folder.glob("venv/lib/python3.*/site-packages"))
    with zipfile.ZipFile(built) as archive:
        archive.extractall(site)
        (metadata,) = (archive.read(each).decode() for each in archive.namelist() if "METADATA" in each)
    demanded = required(re.findall(r"^Requires-Dist: (.*)$", metadata, re.MULTILINE))
    assert not demanded & {"numpy", "numba", "scipy", "opencv-python-headless"}
    for name in demanded:
        for file in importlib.metadata.files(name) or []:
            top = file.parts[0]
            if top != ".." and not (site / top).exists():
                (site / top).symlink_to(Path(str(importlib.metadata.distribution(name).locate_file(top))))
    return folder / "venv" / "bin" / "python"


def run(python: Path, *arguments: str) -> str:
    """What the suites' command prints."""
    done = subprocess.run(
        [python, "-I", "-m", "conformance", *arguments], cwd=python.parent, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_it_lists_its_cases_and_brings_the_dissector(python: Path) -> None:
    assert "COMMAND with any single bit flipped" in run(python, "reference", "--list").replace("\n", " ")
    assert "--unit" in run(python, "coupler", "--help")
    probe = "from dissector import SCRIPT; print(SCRIPT.is_file())"
    assert subprocess.check_output([python, "-I", "-c", probe], text=True).strip() == "True"


@pytest.mark.realtime
def test_it_asks_a_controller_and_has_nothing_else_of_ours(python: Path) -> None:
    with ControllerUnderTest() as controller:
        said = run(python, "reference", "--port", str(controller.port), "--case", "101")
    assert "1 pass, 0 flaky, 0 fail, 0 unsupported" in said
    others = ("numpy", "numba", "cv2", "controller", "testbed")
    probe = f"import importlib.util as u; print([each for each in {others} if u.find_spec(each)])"
    assert subprocess.check_output([python, "-I", "-c", probe], text=True).strip() == "[]"
