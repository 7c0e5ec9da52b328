"""The wheel alone, unpacked beside an empty folder: it has all that it runs with."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from typer.testing import CliRunner

from foundation.command_options import shipped_configs
from testbed.cli.main import app
from tests.support.paths import CONFIGS, ROOT

pytestmark = pytest.mark.slow("a wheel is built, and commands run from it")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built by the back end itself: neither pip nor a registry is asked."""
    (built,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("dist")))
    return Path(built)


@pytest.fixture
def installed(wheel: Path, tmp_path: Path) -> Path:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    (tmp_path / "empty").mkdir()
    return tmp_path / "site"


def run(site: Path, *arguments: str) -> str:
    """What Python prints, with the unpacked wheel before all else, in an empty folder."""
    environment = os.environ | {"PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=site.parent / "empty",
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_configuration_and_the_consoles_page_are_in_it(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    configs = {f"longreach/{path.relative_to(ROOT)}" for path in CONFIGS.rglob("*") if path.is_file()}
    assert len(configs) > 15
    assert configs <= names
    assert "longreach/py.typed" in names
    pages = [
        str(path.relative_to(ROOT))
        for package in ("vision_pc", "foundation", "testbed")
        for path in (ROOT / package).rglob("*")
        if path.suffix in {".html", ".js", ".css", ".j2"}
    ]
    assert len(pages) > 10
    assert set(pages) <= names


def test_an_empty_folder_finds_the_configuration(installed: Path) -> None:
    told = run(
        installed,
        "-c",
        "from foundation.command_options import usual_configs as at;"
        "from foundation.configuration import laid_over;"
        "print(at(), laid_over(at() / 'arms/long_crane', 'plant.yaml')[0]['geometry']['telescope_m'])",
    )
    assert told.split() == [str(installed / "longreach" / "configs"), "3.0"]


_WITHOUT_LABORATORY = (
    "import sys; sys.modules['laboratory'] = None; from testbed.cli.main import app; app({})"
)


def test_the_laboratory_is_not_in_it_and_its_commands_say_how_to_get_it(installed: Path) -> None:
    assert not (installed / "laboratory").exists()
    assert not (installed / "tools").exists()
    helped = run(installed, "-c", _WITHOUT_LABORATORY.format(["--help"]))
    assert "that write tables" not in helped
    assert "demo" in helped
    run(installed, "-c", _WITHOUT_LABORATORY.format(["arm", "list"]))
    with pytest.raises(AssertionError, match=r"extension\.not_installed.*pip install \./laboratory"):
        run(installed, "-c", _WITHOUT_LABORATORY.format(["experiment", "--help"]))


@pytest.mark.experiment
def test_the_demonstration_ends_at_the_object(installed: Path) -> None:
    run(installed, "-c", _WITHOUT_LABORATORY.format(["demo", "--lockstep", "--seed", "1"]))
    run(installed, "-m", "testbed.cli.main", "init")
    run(installed, "-m", "testbed.cli.main", "arm", "check", "long_crane")


def test_init_copies_what_is_shipped_once(tmp_path: Path) -> None:
    def copied() -> int:
        return CliRunner().invoke(app, ["init", str(tmp_path / "mine")]).exit_code

    assert copied() == 0
    names = [sorted(p.relative_to(d) for p in d.rglob("*")) for d in (shipped_configs(), tmp_path / "mine")]
    assert names[0] == names[1]
    assert copied() == 2


def test_the_controller_in_structured_text_runs_from_it(installed: Path) -> None:
    program = """
from foundation.command_options import shipped_configs
from foundation.configuration import load
from controller.config import ControllerConfig
from controller_st.program import TextController
from nominal_arm.description import NominalArm

files = shipped_configs()
arm, config = load(NominalArm, files / "arm.yaml"), load(ControllerConfig, files / "controller.yaml")
text = TextController(arm, config, 1, lambda: 2)
print(text.step(1, 1, 0.005, None), text.valve_words[0], text.__module__)
"""
    assert run(installed, "-c", program).split() == ["None", "1", "controller_st.program"]
