"""What bends, slips and rocks: off without a trace, on as configured, refused where it cannot be."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.layout import N_STATES
from plant_emulator.core.mechanics import loose
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from tests.plant_emulator.mechanics.structure_world import ENTRIES
from tests.plant_emulator.plant_world import CONFIGS, CYCLE_NS, Driver, plant_config

Array = NDArray[np.float64]


def on(*names: str, **numbers: dict[str, Any]) -> dict[str, Any]:
    return {name: {"enabled": True, **numbers.get(name, {})} for name in {*names, *numbers}}


def everything(arm: str, **changes: Any) -> PlantConfig:
    return load(PlantConfig, CONFIGS / arm, {"errors": on(*ENTRIES), **changes})


@pytest.mark.parametrize("arm", ["plant.yaml", "arms/long_crane/plant.yaml"])
def test_both_arms_run_with_everything_on_and_a_seed_repeats(arm: str) -> None:
    ends = []
    for seed in (3, 3, 4):
        plant = Plant(everything(arm), seed)
        driver = Driver(plant)
        driver.run(0.5, (0.3, 0.3, -0.3, 0.2, -0.2, 0.3))
        driver.run(1.0)
        ends.append(plant.truth())
        assert np.isfinite(ends[-1].X_WT).all()
        assert ends[-1].pressures.min() > 0.0
    assert (ends[0].X_WT == ends[1].X_WT).all()
    assert not (ends[0].X_WT == ends[2].X_WT).all()  # the engine's phase


@pytest.mark.parametrize("entry", ENTRIES)
def test_an_entry_that_is_off_leaves_no_state_and_no_trace(entry: str) -> None:
    """Its numbers may be anything: not a bit changes while it is off."""
    raw = plant_config().model_dump()["errors"][entry]
    changed = {k: 0.5 * v for k, v in raw.items() if isinstance(v, float) and k not in ("static_nm",)}
    ends = []
    for errors in ({}, {entry: changed}):
        plant = Plant(plant_config(errors=errors), 5)
        assert plant._state.size == N_STATES
        Driver(plant).run(0.2, (0.3, 0.2, -0.2, 0.1, 0.1, 0.1))
        ends.append(plant._state.copy())
    np.testing.assert_array_equal(ends[0], ends[1])


def test_side_load_decides_the_flank_and_not_the_last_turn() -> None:
    """Whichever way the slew turned last, the boom comes to lie where hoses pull it."""
    lies = []
    for pull in (-200.0, 200.0):
        for last in (-0.2, 0.2):
            slew = {"hose_nm": pull, "hose_nm_rad": 0.0, "backlash_mrad": 2.0}
            plant = Plant(plant_config(errors=on(loose_slew=slew)), 1)
            driver = Driver(plant)
            driver.run(0.3, (-last, 0.0, 0.0, 0.0, 0.0, 0.0))
            driver.run(0.3, (last, 0.0, 0.0, 0.0, 0.0, 0.0))
            driver.run(6.0)
            at = int(plant._model.loose.mesh[loose.M_AT])
            lies.append(1e3 * plant._state[plant._model.places.angle[at]])
    assert (np.sign(lies) == [-1.0, -1.0, 1.0, 1.0]).all()
    assert np.abs(np.abs(lies) - 1.05).max() < 0.06


def test_a_boom_that_is_pulled_off_both_flanks_starts_between_them() -> None:
    slew = {"hose_nm": 3.0, "hose_nm_rad": 5e4, "backlash_mrad": 2.0}
    plant = Plant(plant_config(errors=on(loose_slew=slew)), 1)
    at = plant._model.places.angle[int(plant._model.loose.mesh[loose.M_AT])]
    began = float(plant._state[at])
    assert abs(began) < 0.5e-3  # of 1 mrad to either flank
    Driver(plant).run(0.5)
    assert plant._state[at] == pytest.approx(began, abs=2e-5)


def test_encoders_do_not_see_the_play() -> None:
    tips, counts = [], []
    for pull in (-100.0, 100.0):
        slew = {"hose_nm": pull, "hose_nm_rad": 0.0, "backlash_mrad": 2.0}
        errors = on(loose_slew=slew) | {"encoder_noise": {"enabled": False}}
        plant = Plant(plant_config(errors=errors), 1)
        tips.append(plant.truth().X_WT[1, 3])
        counts.append(plant.read().encoder_counts)
    assert counts[0] == counts[1]
    assert tips[1] - tips[0] == pytest.approx(2.05e-3 * 3.88, rel=0.02)


def test_the_truth_rocks_with_the_base() -> None:
    plant = Plant(plant_config(errors=on("rocking_base")), 1)
    stiff = Plant(plant_config(), 1).truth()
    before = plant.truth()
    assert before.X_WT[2, 3] < stiff.X_WT[2, 3] - 5e-3  # the arm's weight leans the carrier
    np.testing.assert_allclose(before.X_BT, stiff.X_BT, atol=1e-4)  # in the base, the arm is as it was
    Driver(plant).run(0.5, (0.0, 0.8, 0.0, 0.0, 0.0, 0.0))
    after = plant.truth()
    assert np.abs(after.X_WB - before.X_WB).max() > 1e-4
    np.testing.assert_allclose(after.X_WB @ after.X_BT, after.X_WT, atol=1e-12)


def test_a_load_beside_the_axis_twists_the_arm() -> None:
    level = []
    for entry in (False, True):
        payload = {"mass_kg": 100.0, "centre_m": [0.3, 0.0, 0.0]}
        plant = Plant(plant_config(payload=payload, errors={"torsion": {"enabled": entry}}), 1)
        level.append(plant.truth().X_WT[2, 0])
    assert level[1] - level[0] < -1.5e-3  # T's x axis, to the right, goes down


@pytest.mark.parametrize(
    ("errors", "parts"),
    [
        (on("vibration"), ["errors.vibration", "rocking_base.enabled", "rigid base"]),
        (on(finer_bending={"boom_at": [0.5, 0.8]}), ["finer_bending.boom_at", "0.5", "before a third"]),
        (on(finer_bending={"arm_at": [0.6, 0.3]}), ["finer_bending.arm_at", "rise from 0 to 1"]),
        (on(finer_bending={"arm_at": [0.3]}), ["finer_bending.arm_at"]),
        (on(rocking_base={"gyration_m": [0.1, 0.1, 2.0]}), ["rocking_base.gyration_m", "no body"]),
        (on(loose_slew={"friction": {"static_nm": 1.0}}), ["static_nm", "1.0", "Coulomb level 20"]),
        (on(bearing_tilt={"play_mm": -0.1}), ["bearing_tilt.play_mm", "-0.1"]),
        (on(encoder_eccentricity={"mrad": [0.1]}), ["encoder_eccentricity.mrad"]),
    ],
)
def test_what_cannot_be_is_refused(errors: dict[str, Any], parts: list[str]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        plant_config(errors=errors)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("errors", "named"),
    [
        (on(loose_slew={"contact_nm_rad": 4e8}), "a flank of errors.loose_slew"),
        (on(loose_slew={"motor_side_kg_m2": 0.5}), "(slew|loose_slew)"),
        (on(bearing_tilt={"stiffness_nm_rad": 1e10}), "the ring of errors.bearing_tilt"),
        (on(pin_compliance={"tilt_nm_rad": 1e9}), "tilt_pin|arm_twist"),
        (on(finer_bending={"stop_damping_share": 1.0}), "the end stop of lift"),
    ],
)
def test_a_step_too_long_is_refused_with_the_part_that_would_not_bear_it(
    errors: dict[str, Any], named: str
) -> None:
    with pytest.raises(
        ConfigurationError, match=rf"step_ms = 0\.5: must not exceed 0\.\d+, .*({named})"
    ) as caught:
        Plant(plant_config(errors=errors), 1)
    assert caught.value.cause == "configuration.unstable_step"


def test_a_payload_falls_off_a_loose_and_rocking_arm() -> None:
    plant = Plant(everything("plant.yaml", payload={"mass_kg": 150.0, "centre_m": [0.1, 0.0, 0.2]}), 7)
    Driver(plant).run(0.2)
    plant.set_payload(0.0)
    for _ in range(200):
        plant.advance(CYCLE_NS)
    assert np.isfinite(plant._state).all()
    assert np.abs(plant.truth().q_rate).max() < 0.5
