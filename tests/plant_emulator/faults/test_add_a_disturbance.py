"""docs/how_to/add_a_disturbance.md does what it says: its scenario is drawn, its fault is injected."""

import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from plant_emulator.core import plant as plant_module
from plant_emulator.core.faults import effects, kinds
from tests.support.pages import page
from tests.support.paths import ROOT, copied_configs

TEXT = page("how_to/add_a_disturbance.md")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
SCENARIO = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)[0]


@pytest.fixture
def configs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the configuration in the working directory, with the page's scenario in it."""
    configs = copied_configs(tmp_path / "configs")
    (configs / "scenarios" / "hot_oil.yaml").write_text(SCENARIO, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return configs


def test_the_page_s_scenario_draws_a_hot_and_heavy_world(configs: Path) -> None:
    drawn: dict[str, Any] = {}
    exec(BLOCKS[0], drawn)
    assert 45.0 <= drawn["settings"].plant.oil.temperature_degc <= 65.0
    assert 50.0 <= drawn["settings"].plant.payload.mass_kg <= 150.0
    assert drawn["settings"].plant.oil.ambient_degc == 35.0


def test_the_page_s_fault_swings_the_encoder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The class in the namespace of ``kinds``, the branch in the source of ``effects`` as the page says."""
    monkeypatch.chdir(ROOT)
    made = ModuleType("kinds_with_wobble")
    made.__dict__.update(vars(kinds))
    exec(BLOCKS[1], made.__dict__)
    source = Path(str(effects.__file__)).read_text(encoding="utf-8")
    before = source.index("    return shift\n")
    changed = ModuleType("effects_with_wobble")
    changed.__dict__["EncoderWobble"] = made.EncoderWobble
    exec(source[:before] + BLOCKS[2] + source[before:], changed.__dict__)
    monkeypatch.setattr(plant_module, "encoder_shift", changed.encoder_shift)
    exec("from pathlib import Path\n" + BLOCKS[3], made.__dict__)
    counts = int(capsys.readouterr().out)
    assert 206 <= counts <= 211
    assert "It prints about 209" in TEXT
