"""Rough treatment at random poses: a sudden stop, a payload drop, an end-stop impact, a pump loss."""

import math
from typing import Any

import numpy as np
import pytest

from laboratory.campaigns.rows import typed
from laboratory.validation.ledger import Ledger
from laboratory.validation.plant_balances import resting_arm
from laboratory.validation.rough_treatment import (
    ENERGY_LIMIT,
    EVENTS,
    MASS_LIMIT,
    TreatmentRow,
    drawn_arm,
    summary,
    treat,
)
from plant_emulator.core.layout import PRESSURE_A
from plant_emulator.core.right_hand_side import EncoderShafts, advance, new_work
from tests.plant_emulator.plant_world import CONFIGS

POSE = [20.0, 40.0, -80.0, 10.0, -30.0, 20.0]


@pytest.mark.parametrize("event", EVENTS)
def test_rough_treatment_is_survived_and_the_books_balance(event: str) -> None:
    row = treat(CONFIGS, {"event": event, "seed": 11, "step_ms": 0.25})
    assert row["finite"]
    assert row["least_bar"] > 0.0
    assert row["greatest_bar"] < 300.0
    assert row["energy_error"] < ENERGY_LIMIT
    assert row["mass_error"] < MASS_LIMIT
    assert row["stop_met"] or event != "end-stop impact"


def test_a_seed_repeats_bit_for_bit() -> None:
    task = {"event": "sudden stop", "seed": 12, "step_ms": 0.5}
    assert treat(CONFIGS, task) == treat(CONFIGS, task)


def test_the_books_are_kept_beside_the_plants_own_steps() -> None:
    """The ledger's steps are the plant's, bit for bit, with the drive's slew limit."""
    target, idle = np.array([0.4, 0.7, -0.6, 0.3, -0.2, 0.5]), np.zeros((3, 6))
    plain, booked = resting_arm(CONFIGS, POSE, 80.0), resting_arm(CONFIGS, POSE, 80.0)
    shafts = EncoderShafts(idle[1], idle[2])
    advance(plain.state, idle[0], target, shafts, 1000, 5e-4, plain.model, new_work(plain.model))
    booked.command[:] = target
    Ledger(booked).run(0.5, 5e-4)
    np.testing.assert_array_equal(plain.state, booked.state)


def test_oil_made_out_of_nothing_and_energy_lost_are_noticed() -> None:
    """One bar more in the lift's bore, as clipping a pressure would make it, is a thousand limits."""
    stand, _ = drawn_arm(CONFIGS, 3)
    stand.command[:] = 0.3
    ledger = Ledger(stand)
    fair = ledger.run(0.2, 2.5e-4)
    before = ledger._stored_energy_and_mass()
    stand.state[PRESSURE_A + 1] += 1e5
    after = ledger._stored_energy_and_mass()
    assert fair.mass_error < 1e-7
    assert ((after[1] - before[1]) / before[1]).max() > 10.0 * MASS_LIMIT
    assert abs(after[0] - before[0]) > 1.0


def row(**changes: Any) -> TreatmentRow:
    fair = {
        "event": "pump loss", "finite": True, "least_bar": 2.0, "greatest_bar": 200.0,
        "energy_error": 1e-6, "mass_error": 1e-9, "stop_met": False, "end_mrad_s": 1.0,
    }  # fmt: skip
    return typed(TreatmentRow, fair | changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"finite": False},
        {"least_bar": -0.01},
        {"energy_error": 2e-3},
        {"mass_error": 2e-6},
        {"mass_error": None},
        {"least_bar": math.nan},
    ],
)
def test_one_bad_run_fails_its_event(changes: dict[str, Any]) -> None:
    assert summary([row(), row()])[0].kept
    assert not summary([row(), row(**changes)])[0].kept
