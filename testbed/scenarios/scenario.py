"""Named scenarios: overrides of the truth's configuration, drawn from distributions by a seed.

A scenario is one YAML file: fixed ``overrides`` of configuration files, and ``draws``, which give one dotted
key each a distribution. The same scenario with the same seed is the same world; a draw depends on its own key
and the seed only, so that adding one draw leaves all others as they were.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import yaml
from pydantic import Field, model_validator

from controller.config import ControllerConfig
from foundation.configuration import (
    StrictModel,
    laid_over,
    layers,
    load,
    merged,
    parse_overrides,
    parse_yaml,
    validated,
)
from nominal_arm.description import NominalArm
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.config.service import PlantServiceConfig
from plant_emulator.core.faults.kinds import FAULTS
from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import ConfigurationError
from vision_pc.config.vision import VisionConfig


class NamedRequest(NamedTuple):
    """A program, and what its request says."""

    name: str
    body: Mapping[str, Any]


def named_request(word: str) -> NamedRequest:
    """``NAME[,KEY=VALUE…]``, values as in YAML. Raises ConfigurationError (``configuration.bad_word``)."""
    name, *pairs = _parts(word)
    body = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not key or not equals:
            raise ConfigurationError("configuration.bad_word", f"{word}: {pair!r}: wanted KEY=VALUE")
        body[key.strip()] = parse_yaml(value, f"{word}: {pair!r}")
    return NamedRequest(name.strip(), body)


def fault_orders(words: Sequence[str]) -> tuple[FaultOrder, ...]:
    """What to break. ``start_after_s`` and ``duration_s`` say when.

    Raises ConfigurationError.
    """
    return tuple(_order(word) for word in words)


def _order(word: str) -> FaultOrder:
    kind, body = named_request(word)
    if kind not in FAULTS:
        known = ", ".join(FAULTS)
        raise ConfigurationError(
            "configuration.unknown_fault", f"--fault {kind}: no such kind; known: {known}"
        )
    when = {key: body[key] for key in ("start_after_s", "duration_s") if key in body}
    fault = {"kind": kind} | {key: value for key, value in body.items() if key not in when}
    return validated(FaultOrder, {"fault": fault} | when, f"--fault {word}")


def _parts(word: str) -> list[str]:
    """``word`` cut at its commas, but for those inside brackets."""
    parts, depth = [""], 0
    for character in word:
        depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts


_SCENARIOS = "scenarios"

Value = float | list[float]


class Uniform(StrictModel):
    """Evenly between ``low`` and ``high``; lists draw one number for each entry."""

    kind: Literal["uniform"]
    low: Value
    high: Value

    @model_validator(mode="after")
    def _check_order(self) -> "Uniform":
        if np.shape(self.low) != np.shape(self.high):
            raise ValueError("low and high are of different length")
        if np.any(np.asarray(self.low) > np.asarray(self.high)):
            raise ValueError("low is above high")
        return self

    def draw(self, generator: np.random.Generator) -> Any:
        """The number, or list of numbers."""
        drawn = generator.uniform(self.low, self.high)
        return drawn.tolist() if isinstance(self.low, list) else float(drawn)


class Normal(StrictModel):
    """Gaussian around ``mean``, cut off at three standard deviations so that no world leaves its bounds."""

    kind: Literal["normal"]
    mean: Value
    std: Value

    def draw(self, generator: np.random.Generator) -> Any:
        """The number, or list of numbers."""
        deviation = np.clip(generator.standard_normal(np.shape(self.mean)), -3.0, 3.0)
        drawn = np.asarray(self.mean) + np.asarray(self.std) * deviation
        return drawn.tolist() if isinstance(self.mean, list) else float(drawn)


class Ball(StrictModel):
    """A vector of random direction and a length evenly between 0 and ``radius`` (say, a rotation vector)."""

    kind: Literal["ball"]
    radius: float = Field(ge=0.0)

    def draw(self, generator: np.random.Generator) -> list[float]:
        """The vector as a list."""
        direction = generator.standard_normal(3)
        scaled = direction * (generator.uniform(0.0, self.radius) / np.linalg.norm(direction))
        return [float(value) for value in scaled]


class SeedDraw(StrictModel):
    """An integer seed for somebody else's generator."""

    kind: Literal["seed"]

    def draw(self, generator: np.random.Generator) -> int:
        """A whole number below 2**31."""
        return int(generator.integers(2**31))


Distribution = Annotated[Uniform | Normal | Ball | SeedDraw, Field(discriminator="kind")]


class Scenario(StrictModel):
    """What ``configs/scenarios/NAME.yaml`` holds.

    ``overrides``: file name → nested keys, fixed. ``draws``: dotted key, file name first → distribution.
    """

    description: str
    overrides: dict[str, dict[str, Any]] = Field(default_factory=dict)
    draws: dict[str, Distribution] = Field(default_factory=dict)

    def world(self, seed: int) -> dict[str, dict[str, Any]]:
        """The overrides of configuration files (file name → nested keys) that ``seed`` makes of it."""
        result: dict[str, Any] = dict(self.overrides)
        for key, distribution in self.draws.items():
            stream = np.random.default_rng([seed, zlib.crc32(key.encode())])
            result = merged(result, nested(key, distribution.draw(stream)))
        return result


def nested(key: str, value: Any) -> dict[str, Any]:
    """``value`` below the parts of the dotted ``key``, outermost first."""
    for part in reversed(key.split(".")):
        value = {part: value}
    return dict(value)


def flattened(overrides: Mapping[str, Any], prefix: str = "") -> list[str]:
    """``overrides`` as ``a.b.c=value`` strings, the form that ``--set`` of every service takes."""
    settings: list[str] = []
    for key, value in overrides.items():
        if isinstance(value, Mapping):
            settings += flattened(value, f"{prefix}{key}.")
        else:
            text = yaml.safe_dump(value, default_flow_style=True, width=1 << 20)
            settings.append(f"{prefix}{key}={text.removesuffix('...' + chr(10)).strip()}")
    return settings


def names(config_dir: Path) -> list[str]:
    """The scenarios that ``config_dir`` and its base hold, sorted. Raises ConfigurationError."""
    if not config_dir.is_dir():
        raise ConfigurationError("configuration.no_directory", f"no directory {config_dir}")
    below = (directory / _SCENARIOS for directory in layers(config_dir))
    return sorted({file.stem for directory in below for file in directory.glob("*.yaml")})


def load_scenario(config_dir: Path, name: str) -> Scenario:
    """The scenario called ``name``.

    Raises ConfigurationError when there is none, or its file is wrong.
    """
    known_names = names(config_dir)
    if name not in known_names:
        known = ", ".join(known_names) or "none"
        raise ConfigurationError(
            "configuration.unknown_scenario", f"no scenario '{name}' in {config_dir}; known: {known}"
        )
    content, where = laid_over(config_dir, f"{_SCENARIOS}/{name}.yaml")
    return validated(Scenario, content, where)


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
    return {
        name: partial(load, model, config_dir / f"{name}.yaml", overrides.get(name))
        for name, model in MODELS.items()
    }


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
