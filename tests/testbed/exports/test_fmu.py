"""The plant as an FMU, run by FMPy: to the last bit the plant that is stepped by hand."""

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from testbed.exports.fmu import JOINTS, outputs_of, step, write_fmu
from testbed.scenarios.settings import Settings, chosen_overrides, load_settings
from tests.support.paths import CONFIGS

_STEP_S = 0.005


def drawn(seed: int) -> Settings:
    return load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", seed, []))


def commands(times: np.ndarray) -> np.ndarray:
    """Valves (n, 6): every joint moves, there and back."""
    return 0.12 * np.sin(2.0 * times[:, None] + np.arange(6))


@pytest.mark.parametrize("seed", [1, 7])
def test_an_fmu_is_the_plant_to_the_last_bit(tmp_path: Path, seed: int) -> None:
    settings, file = drawn(seed), tmp_path / "plant.fmu"
    write_fmu(settings, seed, file)
    times = np.arange(200) * _STEP_S
    given = np.zeros(len(times), dtype=[("time", float), *[(f"valve_{joint}", float) for joint in JOINTS]])
    given["time"] = times
    for joint, valves in zip(JOINTS, commands(times).T, strict=True):
        given[f"valve_{joint}"] = valves
    plant = Plant(settings.plant, seed, Scene(settings.scene).mounts)
    by_hand = [outputs_of(plant)]
    found = simulate_fmu(
        file,
        stop_time=len(times) * _STEP_S,
        step_size=_STEP_S,
        output_interval=_STEP_S,
        input=given,
        output=list(by_hand[0]),
    )
    for number, valves in enumerate(commands(times), 1):
        step(plant, number, valves.tolist(), _STEP_S)
        by_hand.append(outputs_of(plant))
    assert len(found) == len(by_hand)
    for name in by_hand[0]:
        np.testing.assert_array_equal(found[name], [told[name] for told in by_hand], err_msg=name)
    ways = [found[f"true_q_{joint}_rad"] for joint in JOINTS]
    moved = [abs(float(way[-1] - way[0])) for way in ways]
    assert min(moved) > 1e-3


def test_an_fmu_says_what_it_is(tmp_path: Path) -> None:
    file = tmp_path / "plant.fmu"
    write_fmu(drawn(1), 1, file)
    assert validate_fmu(str(file)) == []
    told = read_model_description(file)
    assert told.coSimulation is not None
    assert told.coSimulation.needsExecutionTool
    inputs = [each.name for each in told.modelVariables if each.causality == "input"]
    assert inputs == [f"valve_{joint}" for joint in JOINTS]


def test_without_its_package_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imported = builtins.__import__

    def absent(name: str, *more: Any, **named: Any) -> Any:
        if name.startswith("pythonfmu"):
            raise ImportError(name)
        return imported(name, *more, **named)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(ConfigurationError, match=r"longreach\[fmu\]") as refused:
        write_fmu(drawn(1), 1, tmp_path / "plant.fmu")
    assert refused.value.cause == "configuration.missing_package"
    assert not (tmp_path / "plant.fmu").exists()
