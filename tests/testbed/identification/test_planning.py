"""Plans of excitation: what a piece tells, what limits forbid, and what is chosen first."""

from pathlib import Path

import numpy as np
import pytest

from foundation.configuration import load
from nominal_arm.description import NominalArm
from plant_emulator.config.plant import PlantConfig
from testbed.identification.excitation import (
    Informed,
    Piece,
    beyond_limits,
    chosen,
    informed,
    not_told,
    record,
)
from testbed.identification.parameters import parameters_of
from testbed.identification.recording import Machine

CONFIGS = Path(__file__).parents[3] / "configs"
MACHINE = Machine("an arm", "0123456789abcdef", "servo")
REST = Piece("rest", (), 0.0, 0.3)


@pytest.fixture(scope="module")
def file() -> PlantConfig:
    return load(PlantConfig, CONFIGS / "plant.yaml", {"payload": {"mass_kg": 40.0}})


@pytest.fixture(scope="module")
def arm() -> NominalArm:
    return load(NominalArm, CONFIGS / "arm.yaml")


@pytest.mark.timeout(600)  # 40 runs of the plant
def test_a_step_of_one_joint_tells_its_own_valve_and_not_anothers(file: PlantConfig, arm: NominalArm) -> None:
    told = informed(file, arm, MACHINE, Piece("step", (1,), 0.06, 1.0))
    assert told.information is not None
    known = parameters_of(file, (0, 1, 2))
    missing = not_told(told.information, known)
    assert {"slew rated flow +", "tilt deadband −"} <= set(missing)
    assert not {"lift rated flow +", "lift rated flow −", "bulk modulus", "payload"} & set(missing)


def test_pieces_beyond_range_or_speed_are_refused(file: PlantConfig, arm: NominalArm) -> None:
    fast = record(file, MACHINE, [REST, Piece("step", (1,), 0.9, 1.0)], [], seed=1)
    assert beyond_limits(fast, arm).startswith("lift at ")
    slow = record(file, MACHINE, [REST, Piece("step", (1,), 0.06, 1.0)], [], seed=1)
    assert beyond_limits(slow, arm) == ""
    told = slow._replace(angles=slow.angles + np.radians(200.0))
    assert "goes to" in beyond_limits(told, arm)


def _informed(name: str, seconds: float, *sizes: float) -> Informed:
    return Informed(Piece("step", (1,), len(name), seconds), np.diag(sizes))


def test_what_gains_most_a_second_comes_first_and_the_time_is_kept() -> None:
    strong, weak, long = (
        _informed("a", 1.0, 100.0, 0.0), _informed("bb", 1.0, 0.0, 10.0), _informed("ccc", 3.0, 200.0, 20.0),
    )  # fmt: skip
    refused = Informed(Piece("step", (0,), 9.0, 0.1), None, "slew at 99 °/s")
    steps = chosen([weak, long, refused, strong], 2.5)
    assert [step.piece.amplitude for step in steps] == [1.0, 2.0]
    assert steps[0].bits == pytest.approx(0.5 * np.log2(101.0))
    assert [step.identified for step in steps] == [1, 2]
    assert chosen([refused], 2.5) == []
    known = chosen([weak, strong], 1.0, before=np.diag([1e6, 0.0]))
    assert [step.piece.amplitude for step in known] == [2.0]  # what is known already gains nothing
