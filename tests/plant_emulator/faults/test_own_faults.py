"""A disturbance of your own: what it does to the plant, and what no plant takes."""

import re
from typing import Any

import numpy as np
import pytest

from plant_emulator.core import layout as col
from plant_emulator.core.faults.kinds import OwnFault
from plant_emulator.core.faults.schedule import NEVER_NS
from plant_emulator.core.plant import Plant
from protocol.errors import RequestRefused
from tests.plant_emulator.plant_world import plant_config


class Swinging(OwnFault):
    kind: str = "swinging"
    every_s = 0.05

    def load_kg(self, elapsed_s: float, load_kg: float) -> float:
        return load_kg * (1.0 + 0.5 * np.sin(2.0 * np.pi * elapsed_s))


def test_effects_are_asked_again_as_often_as_wanted() -> None:
    plant = Plant(plant_config(payload={"mass_kg": 100.0}), seed=1)
    plant.inject(Swinging(), 100_000_000, 500_000_000)
    loads = []
    for _ in range(14):
        plant.advance(50_000_000)
        loads.append(plant.truth().payload_kg)
    swing = 100.0 * (1.0 + 0.5 * np.sin(2.0 * np.pi * np.arange(0.0, 0.5, 0.05)))
    assert loads == pytest.approx([100.0, *swing, 100.0, 100.0, 100.0])
    assert plant.faults.next_ns() == NEVER_NS


@pytest.mark.parametrize(
    ("method", "told"),
    [
        ("load_kg(self, elapsed_s, load_kg): return -1.0", "load_kg gave -1.0: wanted 0 to 1000"),
        ("encoder_shift(self, elapsed_s): return [0.0] * 5", "wanted six numbers in -1 to 1"),
        ("valve_speed(self, elapsed_s): return [2.0] * 6", "wanted six numbers in 0 to 1"),
        ("pump_runs(self, elapsed_s): return 1 / 0", "ZeroDivisionError"),
    ],
)
def test_effects_that_no_plant_takes_are_refused_before_they_are_let_loose(method: str, told: str) -> None:
    text = (
        "from plant_emulator.core.faults.kinds import OwnFault\nclass Bad(OwnFault):\n    kind: str = 'bad'\n"
    )
    made: dict[str, Any] = {}
    exec(f"{text}    def {method}\n", made)
    plant = Plant(plant_config(), seed=1)
    with pytest.raises(RequestRefused, match=re.escape(told)) as refused:
        plant.inject(made["Bad"]())
    assert refused.value.cause == "refused.disturbance"
    assert plant.faults.all() == ()


def test_valves_pump_and_encoders_obey_too() -> None:
    text = """
from plant_emulator.core.faults.kinds import OwnFault
class Worn(OwnFault):
    kind: str = "worn"
    def encoder_shift(self, elapsed_s): return [0.0, elapsed_s * 0.1, 0.0, 0.0, 0.0, 0.0]
    def valve_speed(self, elapsed_s): return [1.0, 0.5, 0.0, 1.0, 1.0, 1.0]
    def pump_runs(self, elapsed_s): return False
"""
    made: dict[str, Any] = {}
    exec(text, made)
    broken, whole = (Plant(plant_config(), seed=1) for _ in range(2))
    broken.inject(made["Worn"]())
    for plant in (broken, whole):
        plant.advance(100_000_000)
    omega = [plant.model.actuators[:, col.A_OMEGA] for plant in (broken, whole)]
    np.testing.assert_allclose(omega[0] / omega[1], [1.0, 0.5, 0.0, 1.0, 1.0, 1.0])
    assert broken.truth().supply < 0.9 * whole.truth().supply
    shift = broken.read().encoder_counts[1] - whole.read().encoder_counts[1]
    assert shift == pytest.approx(0.01 * 131072 / (2.0 * np.pi), abs=25)  # and what the pump's loss lets sink
