"""`longreach picture effects`: every switch that it names exists, every effect changes its picture."""

import json
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.faults.kinds import FAULTS
from testbed.cli.main import app
from testbed.pictures import effects as effect_sheet
from testbed.pictures.effects import CLEAN, Effect, effects
from tests.support.paths import CONFIGS


@pytest.fixture(scope="module")
def shipped() -> SceneConfig:
    return load(SceneConfig, CONFIGS / "scene.yaml")


def test_every_switch_is_a_key_of_the_scene_or_a_fault(shipped: SceneConfig) -> None:
    for effect in effects(shipped):
        keys = (effect.on, CLEAN | dict(effect.off))
        on, off = (load(SceneConfig, CONFIGS / "scene.yaml", overrides) for overrides in keys)
        if effect.fault is None:
            assert on != off, effect.name
            path = effect.switch.split(" ")[0].replace("markers[].", "tool_marker.").split(".")
            value: object = on.model_dump()
            for key in path:
                assert isinstance(value, dict), effect.switch
                assert key.removesuffix("[]") in value, effect.switch
                value = value[key.removesuffix("[]")]
                value = value[0] if key.endswith("[]") else value
        else:
            assert effect.switch.split(" ")[1].rstrip(",") == effect.fault.kind
            assert not effect.on
    named = {effect.fault.kind for effect in effects(shipped) if effect.fault}
    of_camera = {"camera_frozen", "camera_blind", "frames_dropped", "marker_covered"}
    assert named == of_camera <= set(FAULTS)


def test_the_command_shows_an_effect_off_and_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def two(scene: SceneConfig) -> tuple[Effect, ...]:
        expected = ("vignetting", "marker covered")
        return tuple(effect for effect in effects(scene) if effect.name in expected)

    monkeypatch.setattr(effect_sheet, "effects", two)
    figures = tmp_path / "effects.json"
    options = {"--out": tmp_path, "--config-dir": CONFIGS, "--json": figures}
    words = [str(word) for option in options.items() for word in option]
    result = CliRunner().invoke(app, ["picture", "effects", *words])
    assert result.exit_code == 0, result.output
    shown = {row["name"]: row for row in json.loads(figures.read_text())["effects"]}
    assert shown["vignetting"]["changed_percent"] > 90.0
    assert 0.5 < shown["marker covered"]["changed_percent"] < 5.0
    off, on = (cv2.imread(str(tmp_path / f"vignetting_{s}.png"), cv2.IMREAD_GRAYSCALE) for s in ("off", "on"))
    assert off is not None
    assert on is not None
    assert on[:50, :50].mean() < 0.55 * off[:50, :50].mean()
    assert on[340:380, 620:660].mean() == pytest.approx(off[340:380, 620:660].mean(), rel=0.02)
    assert (tmp_path / "camera_effects.png").stat().st_size < 300_000
