"""SETTLED is a promise: the tool stays, or the flag goes and the log says which joint left.

The true tool of the emulated plant against the flag, both arms, both kinds of valves. Ten minutes of it:
``longreach experiment parking``.
"""

import numpy as np
import pytest

from controller.core.servo.settling import MOVING, Settling, settle_joint
from laboratory.experiments.robustness.parking import watched
from laboratory.experiments.robustness.resting_machines import arrived, drawn_machine
from nominal_arm.description import JOINT_NAMES
from protocol.reference_messages import FLAG_SETTLED
from testbed.lockstep.clock import ClosedLoop
from tests.support.paths import CONFIGS

DEAD_ZONE, TOLERANCE, DT_S = 1.2e-4, 3e-4, 0.005


def _settled(arm: str, valves: str, seed: int) -> ClosedLoop:
    """A drawn machine at the moment when SETTLED is set after a drawn motion."""
    loop = arrived(drawn_machine(CONFIGS, {"seed": seed, "arm": arm, "valves": valves}), seed)
    for _ in range(round(45.0 / loop.settings.cycle_s)):
        if loop.view.flags & FLAG_SETTLED:
            return loop
        loop.step()
    raise AssertionError(f"not settled within 45 s: {loop.view}")


@pytest.mark.slow("up to a minute of arm time")
@pytest.mark.parametrize("valves", ["servo", "mobile"])
@pytest.mark.parametrize("arm", ["plant", "plant_long_crane"])
def test_the_tool_stays_while_settled_says_so(arm: str, valves: str) -> None:
    """Before, servo valves drove the crane on by 2.9 mm in a minute (by 7.2 of seed 6102)."""
    loop = _settled(arm, valves, 6107 if valves == "servo" else 6203)
    row = watched(loop, round(25.0 / loop.settings.cycle_s))
    print(f"{arm}, {valves}: {row}")
    assert row["moved_mm"] < row["allowed_mm"]
    assert row["share"] > 0.5


def test_settled_goes_and_names_the_joint_that_left() -> None:
    loop = _settled("plant", "servo", 6102)
    loop.plant.set_payload(loop.plant.truth().payload_kg + 100.0)
    row = watched(loop, 400)
    assert row["share"] < 0.5
    assert row["unsettled"].split()[0].lower() in ("tool", *JOINT_NAMES)


def _passed(errors: np.ndarray) -> list[tuple[bool, bool]]:
    """Whether one joint's integral has stopped, and whether it stands still, after each error (rad)."""
    settling, found = MOVING, []
    for error in errors:
        held, slow, stood, still = settle_joint(0, settling, float(error), (DEAD_ZONE, TOLERANCE), DT_S)
        settling = Settling(*(np.r_[number, np.zeros(5)] for number in (held, slow, stood)))
        found.append((bool(held), still))
    return found


def test_an_integral_stops_inside_the_dead_zone_and_begins_again_beyond_the_tolerance() -> None:
    sizes = np.repeat([2e-4, 1e-4, 2.9e-4, 3.5e-4, 2e-4], 1000)
    held = [stopped for stopped, _ in _passed(sizes)]
    assert [held[k] for k in (999, 1999, 2999, 3999, 4999)] == [False, True, True, False, False]


def test_a_joint_stands_still_that_neither_moves_on_nor_is_outside() -> None:
    """A digit of noise is no motion; 0.1 mrad/s, which a valve that is shut would not allow, is."""
    noise = np.random.default_rng(1).choice([0.0, 4.8e-5], 2000)
    assert all(still for _, still in _passed(1e-4 + noise)[500:])
    moves = [still for _, still in _passed(np.linspace(-2.5e-4, 2.5e-4, 900))]
    assert max(map(len, "".join("01"[still] for still in moves[300:]).split("0"))) < 300  # 1.5 s
    assert not any(still for _, still in _passed(np.full(2000, 3.2e-4))[1000:])
