"""Arms left alone: which machines, what a row tells of them, and what is made of the rows."""

from typing import Any

import pytest
import typer

from controller.core.settings import settings_from
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished
from laboratory.experiments.robustness.parking import (
    ParkingOptions,
    park_and_watch,
    parking_tables,
    parking_tasks,
    parking_verdict,
)
from laboratory.experiments.robustness.resting_machines import drawn_machine, machines
from tests.support.paths import CONFIGS

TASK = {"seed": 6203, "arm": "plant", "valves": "mobile", "cooling": False}


@pytest.mark.slow("half a minute of arm time")
def test_mobile_valves_park_and_stay() -> None:
    """A row counts from the real plant."""
    row = park_and_watch(CONFIGS, TASK | {"minutes": 0.2})
    assert 3.0 < row["settled_s"] < 30.0
    assert 0.0 < row["moved_mm"] < row["allowed_mm"]
    assert row["share"] > 0.9


def test_runs_are_of_the_kinds_in_turn() -> None:
    kinds = [(task["arm"], task["valves"]) for task in machines(8, 50, "mobile,real")]
    assert len(set(kinds)) == 4
    assert kinds[:4] == kinds[4:]
    assert [(task["arm"], task["valves"]) for task in machines(3, 50, "real")] == [
        ("plant", "real"), ("plant_long_crane", "real"), ("plant", "real"),
    ]  # fmt: skip
    with pytest.raises(typer.BadParameter, match="no machines 'reel'; known: servo, mobile, real"):
        list(machines(1, 50, "mobile,reel"))


def test_a_real_machine_is_drawn_without_camera_and_wall() -> None:
    """As the mobile one in its load and its motion, and besides in whatever a machine differs by."""
    mobile, real = (drawn_machine(CONFIGS, TASK | {"valves": valves}) for valves in ("mobile", "real"))
    assert real.mass_kg == mobile.mass_kg
    assert real.settings.plant.oil.bulk_modulus_mpa != mobile.settings.plant.oil.bulk_modulus_mpa
    assert real.settings.plant.valve_set == "mobile"
    assert real.settings.controller.commissioned is not None
    assert real.settings.scene == mobile.settings.scene
    law = settings_from(real.settings.arm, real.settings.controller).parking
    assert law.oil_spring[0] > 0.0


def test_oil_cools_on_degraded_machines_and_where_it_is_wanted() -> None:
    cools = {
        valves: drawn_machine(CONFIGS, TASK | {"valves": valves}).settings.plant.errors.cooling_oil.enabled
        for valves in ("servo", "mobile", "real")
    }
    assert cools == {"servo": False, "mobile": False, "real": True}
    wanted = drawn_machine(CONFIGS, TASK | {"cooling": True}).settings.plant
    assert wanted.errors.cooling_oil.enabled
    assert wanted.oil.temperature_degc == 50.0


REQUEST = CampaignRequest(CONFIGS, CONFIGS, runs=4, seed=9, workers=1)


def test_the_promise_is_kept_or_not_by_the_worst_run_of_each_kind() -> None:
    options = ParkingOptions(machines="mobile,real")
    tasks = parking_tasks(REQUEST, options)
    assert len({task["key"] for task in tasks}) == 4
    rows: list[dict[str, Any]] = [
        task | {"failure": None, "settled_s": 5.0, "moved_mm": 0.4 + 0.3 * k, "allowed_mm": 1.25,
                "share": 0.9, "unsettled": "SLEW LIFT" if k else None}
        for k, task in enumerate(tasks)
    ]  # fmt: skip
    done = Finished(REQUEST, options, tasks, rows, 0)
    moved = [check.met for check in parking_verdict(done) if check.what.startswith("moved")]
    assert moved == [True, True, True, False]
    assert list(parking_tables(done)[0].columns[-1].cells) == ["met", "met", "met", "NOT met"]
    failed = Finished(REQUEST, options, tasks, [rows[0] | {"failure": "fault"}, *rows[1:]], 0)
    assert parking_verdict(failed)[0].met is False
    never = Finished(REQUEST, options, tasks, [row | {"settled_s": None} for row in rows], 0)
    assert parking_verdict(never)[1].met is False
