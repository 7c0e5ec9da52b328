"""The whole configuration, as all three services will load it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from controller.config import ControllerConfig
from foundation.configuration import StrictModel, load, merged, parse_overrides
from nominal_arm.description import NominalArm
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.config.service import PlantServiceConfig
from protocol.errors import ConfigurationError
from testbed.scenarios.scenario import load_scenario
from vision_pc.config.vision import VisionConfig

MODELS: dict[str, type[StrictModel]] = {
    "arm": NominalArm,
    "controller": ControllerConfig,
    "plant": PlantConfig,
    "plant_service": PlantServiceConfig,
    "scene": SceneConfig,
    "vision": VisionConfig,
}

Overrides = Mapping[str, Mapping[str, Any]]


class Settings(NamedTuple):
    """Every configuration file, validated."""

    arm: NominalArm
    controller: ControllerConfig
    plant: PlantConfig
    plant_service: PlantServiceConfig
    scene: SceneConfig
    vision: VisionConfig


def loaders(config_dir: Path, overrides: Overrides) -> dict[str, Callable[[], StrictModel]]:
    """For each configuration file its loader, which raises ConfigurationError when called."""

    def loader(name: str) -> Callable[[], StrictModel]:
        return lambda: load(MODELS[name], config_dir / f"{name}.yaml", overrides.get(name))

    return {name: loader(name) for name in MODELS}


def load_settings(config_dir: Path, overrides: Overrides) -> Settings:
    """All configuration files with ``overrides`` (file name → nested keys) laid over them.

    Raises ConfigurationError for the first fault, and for an override of a file that does not exist.
    """
    unknown = sorted(set(overrides) - set(MODELS))
    if unknown:
        raise ConfigurationError(
            "configuration.unknown_file", f"--set {unknown[0]}…: no such file; known: {', '.join(MODELS)}"
        )
    return Settings(**{name: make() for name, make in loaders(config_dir, overrides).items()})  # type: ignore[arg-type]


def chosen_overrides(
    config_dir: Path, scenario: str | None, seed: int, assignments: list[str]
) -> dict[str, dict[str, Any]]:
    """The overrides of a scenario's world for ``seed``, with the ``--set`` assignments over them.

    Raises ConfigurationError for an unknown scenario or a malformed assignment.
    """
    world = load_scenario(config_dir, scenario).world(seed) if scenario else {}
    return merged(world, parse_overrides(assignments))


def with_face(overrides: Overrides, allow_faults: bool, show_truth: bool = False) -> Overrides:
    """``overrides``, and the emulator's HTTP face allowed to break things, or to tell where the arm is."""
    wanted = {"allowed": allow_faults, "shows_truth": show_truth}
    face = {name: True for name, is_wanted in wanted.items() if is_wanted}
    return merged(overrides, {"plant_service": {"fault_face": face}}) if face else overrides
