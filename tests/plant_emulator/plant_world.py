"""Plants for the tests: the arm as shipped, with changes, driven for a while."""

from typing import Any

import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from protocol.process_image import CONTROL_ENABLE, ValveImage
from tests.support.paths import CONFIGS

CYCLE_NS = 5_000_000
Six = tuple[float, float, float, float, float, float]
SHUT: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def plant_config(**changes: Any) -> PlantConfig:
    """plant.yaml with ``changes`` laid over it."""
    return load(PlantConfig, CONFIGS / "plant.yaml", changes)


def assert_refused(changes: dict[str, Any], parts: list[str]) -> None:
    """``changes`` are refused in one line that has every one of ``parts``: key, value, limit, reason."""
    with pytest.raises(ConfigurationError) as caught:
        plant_config(**changes)
    message = str(caught.value)
    assert "\n" not in message
    assert [part for part in parts if part not in message] == []


class Driver:
    """A controller in miniature: counts its cycles and holds the valves it was told."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.cycle = 0

    def run(self, seconds: float, valves: Six = SHUT, control: int = CONTROL_ENABLE) -> None:
        """Exchange images every 5 ms for ``seconds``."""
        for _ in range(round(seconds / 5e-3)):
            self.cycle += 1
            self.plant.write(ValveImage(self.cycle, control, valves))
            self.plant.advance(CYCLE_NS)
