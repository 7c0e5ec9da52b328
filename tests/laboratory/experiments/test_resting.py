"""Arms that come to rest on the real plant: parked, told, kept; and what is made of the rows."""

import math
from typing import NamedTuple

import numpy as np
import pytest
import typer

from controller.core.parking.joint import JOG
from controller.core.settings import settings_from
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished
from laboratory.campaigns.rows import flat
from laboratory.experiments.robustness import parking
from laboratory.experiments.robustness.parking import (
    ParkingOptions,
    ParkingRow,
    inside_for_good,
    park_and_watch,
    parking_table,
    parking_tasks,
    parking_verdict,
)
from laboratory.experiments.robustness.resting_machines import (
    MachineKind,
    arrived,
    drawn_machine,
    machines,
    stepped,
)
from protocol.faults import Reason
from protocol.pose import Pose
from protocol.reference_messages import FLAG_SETTLED, ReferencePose
from testbed.lockstep.clock import ClosedLoop
from tests.support.paths import CONFIGS

TASK = {"seed": 8102, "arm": "plant", "valves": "mobile", "law": "parking", "parks": True}


class Parked(NamedTuple):
    """A machine that has parked, with the names of what its controller told on the way.

    ``within_s``: inside the tolerance for long enough; ``settled_s``: the flag came; ``parked_s``: told.
    ``moved_mm``: the true tool since the flag; ``inches``: scans with one since then.
    """

    loop: ClosedLoop
    told: list[str]
    within_s: float
    settled_s: float
    parked_s: float
    moved_mm: float
    inches: int


@pytest.fixture(scope="module")
def parked() -> Parked:
    """Seed 8102 parks within 15 s of simulated time, and raises its alarm at a thousandth of a millimetre."""
    machine = drawn_machine(CONFIGS, TASK)
    alarm = machine.settings.controller.parking.model_copy(update={"alarm_mm": 1e-3})
    controller = machine.settings.controller.model_copy(update={"parking": alarm})
    loop = arrived(machine._replace(settings=machine.settings._replace(controller=controller)), 8102)
    told: list[str] = []
    within_s = settled_s = math.nan
    stood, moved_mm, inches = np.zeros(3), 0.0, 0
    for _ in range(round(100.0 / loop.settings.cycle_s)):
        stepped(loop)
        assert loop.outputs is not None
        told += [event.name for event in loop.outputs.events]
        now_s, tool = 1e-9 * loop.now_ns, loop.plant.truth().X_BT[:3, 3]
        if math.isnan(within_s) and loop.state.settled_s >= loop.settings.settled.time:
            within_s = now_s
        if math.isnan(settled_s) and loop.view.flags & FLAG_SETTLED:
            settled_s, stood = now_s, tool.copy()
        if not math.isnan(settled_s):
            moved_mm = max(moved_mm, 1e3 * float(np.linalg.norm(tool - stood)))
            inches += int((loop.state.parking["phase"] == JOG).any())
        if loop.state.standing.parked:
            break
    return Parked(loop, told, within_s, settled_s, now_s, moved_mm, inches)


@pytest.mark.slow("a minute of arm time")
def test_an_arm_is_settled_when_it_will_stay_and_not_before(parked: Parked) -> None:
    """Inside its tolerance the arm still inches on; once it is told to be settled nothing does any more."""
    law = parked.loop.settings.parking
    assert law is not None
    assert parked.within_s + 1.0 < parked.settled_s < parked.parked_s
    assert parked.inches == 0
    assert parked.moved_mm < 0.5
    assert "restless" not in parked.told


def test_mobile_valves_park_and_tell_it(parked: Parked, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every valve centred, the integral stopped, the alarm at its limit, and the next motion takes over."""
    loop, told = parked.loop, parked.told
    assert told.count("parked") == 1
    assert not any(loop.view.valves)
    assert (loop.state.servo.q_cmd == np.array(loop.view.q_meas)).all()
    monkeypatch.setattr(parking, "arrived", lambda _machine, _seed: loop)
    row = park_and_watch(CONFIGS, TASK | {"minutes": 0.05})  # a row counts from the real plant
    assert 0.0 < row["end_mm"] <= row["moved_mm"] < 1.0
    assert row["rested_s"] == row["inside_s"] == 0.0
    assert row["astray"] > 0  # nothing stands to a thousandth of a millimetre
    assert flat(row)["machine_valves"] == "mobile"
    assert loop.state.standing.parked
    x, y, z = loop.view.X_BT.p_m
    near = Pose((x, y, z + 0.02), loop.view.X_BT.q_wxyz)
    assert loop.refer(lambda i: ReferencePose(i, near, 0.0)) is Reason.ACCEPTED
    assert not loop.state.standing.parked
    assert loop.outputs is not None
    assert [event.name for event in loop.outputs.events].count("unparked") == 1


def test_a_joint_came_in_when_it_was_outside_for_the_last_time() -> None:
    outside = np.zeros(1000, dtype=bool)
    outside[[0, 10, 199]] = True
    assert inside_for_good(outside, 0.01) == pytest.approx(2.0)
    assert inside_for_good(np.zeros(1000, dtype=bool), 0.01) == 0.0
    outside[800] = True  # two seconds before the end: not for good
    assert math.isnan(inside_for_good(outside, 0.01))


def test_runs_are_of_the_four_kinds_in_turn() -> None:
    kinds = [(task["arm"], task["valves"]) for task in machines(8, 50, "mobile,real")]
    assert len(set(kinds)) == 4
    assert kinds[:4] == kinds[4:]
    assert [(task["arm"], task["valves"]) for task in machines(3, 50, "real")] == [
        ("plant", "real"), ("plant_long_crane", "real"), ("plant", "real"),
    ]  # fmt: skip
    with pytest.raises(typer.BadParameter, match="no machines 'reel'; known: mobile, real"):
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
    assert law is not None
    assert law.oil_spring[0] > 0.0


REQUEST = CampaignRequest(CONFIGS, CONFIGS, runs=4, seed=9, workers=1)


def test_parking_is_met_or_not_by_the_worst_run_of_each_kind() -> None:
    options = ParkingOptions(machines="mobile,real")
    tasks = parking_tasks(REQUEST, options)
    assert len({task["key"] for task in tasks}) == 4
    rows = [
        ParkingRow("", t["seed"], MachineKind(t["arm"], t["valves"], "parking", 20.0), 10.0, 5.0, 6.0,
                   0.4 + 0.3 * k,
                   0.2, 0.1, 3, 0, 60.0)
        for k, t in enumerate(tasks)
    ]  # fmt: skip
    done = Finished(REQUEST, options, tasks, rows, 0)
    met = {check.what.partition(",")[0]: [] for check in parking_verdict(done)}
    for check in parking_verdict(done):
        met[check.what.partition(",")[0]].append(check.met)
    assert met["moved by most"] == [True, True, True, False]
    assert list(parking_table(done)[0].columns[-1].cells) == ["met", "met", "met", "NOT met"]
    failed = Finished(REQUEST, options, tasks, [rows[0]._replace(failure="fault"), *rows[1:]], 0)
    assert parking_verdict(failed)[0].met is False
    assert len(parking_table(failed)) == 2
