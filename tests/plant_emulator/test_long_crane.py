"""Nothing in the plant is tied to one arm: a crane of 10 m, softer, from a file of its own."""

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.layout import N_COORDINATES
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work
from plant_emulator.core.plant import Plant
from plant_emulator.core.stability import linearised
from tests.plant_emulator.oracles import MujocoArm, PinocchioArm
from tests.plant_emulator.plant_world import CONFIGS, Driver


def crane(**changes: object) -> PlantConfig:
    return load(PlantConfig, CONFIGS / "arms/long_crane/plant.yaml", changes)


def test_is_longer_and_softer_than_the_default_arm() -> None:
    bent, default = Plant(crane(), 1), Plant(load(PlantConfig, CONFIGS / "plant.yaml"), 1)
    stiff = Plant(crane(flexibility={"enabled": False}), 1).truth()
    assert np.linalg.norm(bent.truth().X_BT[:3, 3]) > 8.0
    assert stiff.X_BT[2, 3] - bent.truth().X_BT[2, 3] > 50e-3
    lowest = [
        min(abs(m) for m in np.linalg.eigvals(linearised(p._model, p._state, np.zeros(6))) if m.imag > 0.1)
        for p in (bent, default)
    ]
    assert lowest[0] < 0.7 * lowest[1]


def test_its_accelerations_agree_with_both_oracles() -> None:
    plant = Plant(crane(), 1)
    mech, own = plant._model.mechanism, np.zeros(N_COORDINATES)
    rng, work = np.random.default_rng(6), multibody_work(N_COORDINATES)
    for arm in (MujocoArm(mech), PinocchioArm(mech)):
        for _ in range(20):
            q, rate = rng.uniform(-0.8, 0.8, N_COORDINATES), rng.normal(0.0, 0.3, N_COORDINATES)
            force = rng.normal(0.0, 100.0, N_COORDINATES)
            forward_dynamics(q, rate, force, mech, work, own)
            np.testing.assert_allclose(own, arm.acceleration(q, rate, force), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("opening", [0.3, -0.3])
def test_moves_and_stops(opening: float) -> None:
    plant = Plant(crane(), 1)
    driver = Driver(plant)
    start = plant.truth()
    driver.run(1.0, (opening, opening, opening, opening, opening, opening))
    assert (np.sign(plant.truth().q - start.q) == np.sign(opening)).all()
    driver.run(6.0)
    assert np.abs(plant.truth().q_rate).max() < 0.02
    assert plant.truth().pressures.min() > 0.0
