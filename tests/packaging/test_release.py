"""What a release is named after, and whether its wheel can be built again."""

import hashlib
import re
import tomllib
from pathlib import Path

import pytest
import yaml
from hatchling.builders.wheel import WheelBuilder

from tests.support.paths import ROOT

PROJECTS = ("pyproject.toml", "conformance/pyproject.toml", "laboratory/pyproject.toml")


def test_all_that_states_a_version_states_the_same() -> None:
    stated = {
        name: tomllib.loads((ROOT / name).read_text(encoding="utf-8"))["project"]["version"]
        for name in PROJECTS
    }
    stated["CITATION.cff"] = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"]
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    stated["CHANGELOG.md"] = re.findall(r"^## (\d+\.\d+\.\d+)", changes, re.MULTILINE)[0]
    stated["README.md"] = re.findall(r"version (\d+\.\d+\.\d+)", (ROOT / "README.md").read_text())[0]
    assert len(set(stated.values())) == 1, stated
    assert len(changes.splitlines()) <= 80


@pytest.mark.slow("two wheels are built")
def test_a_wheel_built_twice_has_the_same_bytes(tmp_path: Path) -> None:
    built = [Path(next(iter(WheelBuilder(str(ROOT)).build(directory=str(tmp_path / name))))) for name in "ab"]
    assert built[0].name.startswith("longreach-0.")
    assert len({hashlib.sha256(wheel.read_bytes()).hexdigest() for wheel in built}) == 1
