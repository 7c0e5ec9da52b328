"""Rough treatment at random poses: a sudden stop, a payload drop, an end-stop impact, a pump loss."""

import numpy as np
import pytest

from plant_emulator.core import columns as col
from plant_emulator.core.faults import SupplyLost
from plant_emulator.core.layout import N_COORDINATES, RATE
from plant_emulator.core.model import put_payload
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from testbed.validation.ledger import CHAMBERS, Ledger
from testbed.validation.plant_balances import resting_arm
from tests.plant_emulator.plant_world import CONFIGS, SHUT, Driver, Six, plant_config

EVENTS = ("sudden stop", "payload drop", "end-stop impact", "pump loss")


class Roughness:
    """A random pose, load and valve command."""

    def __init__(self, rng: np.random.Generator) -> None:
        slew, lift, tilt = rng.uniform(-110, 110), rng.uniform(-5, 95), rng.uniform(-140, -25)
        self.pose = [float(slew), float(lift), float(tilt), *(float(a) for a in rng.uniform(-80, 80, 3))]
        self.load = float(rng.uniform(0.0, 200.0))
        a, b, c, d, e, f = (float(u) for u in rng.uniform(-1, 1, 6))
        self.valves: Six = (a, b, c, d, e, f)

    def hard_over(self) -> Six:
        """The valves full open, each to its side."""
        a, b, c, d, e, f = (1.0 if u > 0.0 else -1.0 for u in self.valves)
        return (a, b, c, d, e, f)


def rough_case(seed: int) -> tuple[Roughness, Plant]:
    """The first random pose of ``seed`` whose load the supply can carry."""
    rng = np.random.default_rng(seed)
    while True:
        case = Roughness(rng)
        try:
            return case, Plant(plant_config(start_pose_deg=case.pose, payload={"mass_kg": case.load}), seed)
        except ConfigurationError:  # this load is too much for this pose: draw another
            continue


def treat(seed: int) -> tuple[float, float, float]:
    """Ten seconds with event ``seed % 4``; least and greatest pressure (Pa), speed at the end (rad/s)."""
    case, plant = rough_case(seed)
    driver, event = Driver(plant), EVENTS[seed % 4]
    driver.run(1.0, case.valves)
    if event == "payload drop":
        plant.set_payload(0.0)
    elif event == "end-stop impact":
        driver.run(2.0, case.hard_over())
    elif event == "pump loss":
        plant.inject(SupplyLost())
        driver.run(1.0, case.valves)
    least, most = np.inf, 0.0
    for _ in range(90):
        driver.run(0.1, SHUT)
        assert np.isfinite(plant._state).all(), f"seed {seed}: {event} from {case.pose}"
        pressures = plant._state[CHAMBERS]
        least, most = min(least, float(pressures.min())), max(most, float(pressures.max()))
    return least, most, float(np.abs(plant._state[RATE : RATE + N_COORDINATES]).max())


@pytest.mark.parametrize("seed", range(4))
def test_rough_treatment_is_survived(seed: int) -> None:
    least, most, speed = treat(seed)
    assert least > 0.0
    assert most < 300e5
    assert speed < 1.0


@pytest.mark.experiment
@pytest.mark.timeout(3600)
def test_five_hundred_rough_treatments() -> None:
    results = np.array([treat(seed) for seed in range(500)])
    print(f"pressures {results[:, 0].min() / 1e5:.2f} … {results[:, 1].max() / 1e5:.1f} bar")
    assert results[:, 0].min() > 0.0
    assert results[:, 1].max() < 350e5


def balanced(seed: int, seconds: float) -> tuple[float, float]:
    """Worst relative errors of the books of energy and oil mass around the event of ``seed``."""
    case, _ = rough_case(seed)
    stand = resting_arm(CONFIGS, case.pose, case.load)
    ledger, event = Ledger(stand), EVENTS[seed % 4]
    stand.command[:] = case.valves
    books = [ledger.run(1.0, 5e-4)]
    if event == "payload drop":
        put_payload(stand.model, stand.tool, 0.0, stand.config, stand.chain)
    elif event == "end-stop impact":
        stand.command[:] = case.hard_over()
        books.append(ledger.run(1.0, 5e-4))
    elif event == "pump loss":
        stand.model.circuit[col.C_RUNNING] = 0.0
    stand.command[:] = 0.0
    books.append(ledger.run(seconds, 5e-4))
    turnover = sum(abs(book.given) for book in books)
    energy = abs(sum(book.given - book.accounted for book in books)) / turnover
    return energy, max(book.mass_error for book in books)


@pytest.mark.parametrize("seed", range(4))
def test_books_balance_through_the_event(seed: int) -> None:
    energy, mass = balanced(seed, 0.3)
    assert energy < 1e-3
    assert mass < 1e-6


@pytest.mark.experiment
@pytest.mark.timeout(3600)
def test_books_of_forty_treatments_balance() -> None:
    worst = np.array([balanced(seed, 9.0) for seed in range(40)]).max(axis=0)
    print(f"energy {worst[0]:.2e}, oil mass {worst[1]:.2e}")
    assert worst[0] < 1e-3
    assert worst[1] < 1e-6
