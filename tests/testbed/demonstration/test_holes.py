"""The demonstration at drill holes: which are driven to, and that each is judged by its own true place."""

from typing import Any

import numpy as np
import pytest

from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth, tool_error
from protocol.errors import MeasurementFailed
from testbed.demonstration.sequence import (
    Clicked,
    Recorder,
    Rest,
    TimedTruth,
    aimed_truths,
    stages,
    visit_holes,
)
from testbed.reporting.console import bars
from testbed.reporting.outcome import Array, Outcome, verdict
from testbed.reporting.report import Picture
from tests.plant_emulator.plant_world import plant_config

HOLES_O = np.array([[0.0, 0.0, 0.0], [0.2, 0.1, 0.003], [-0.2, 0.0, 0.0]])


class StubRig:
    """Sees four holes and drives nowhere."""

    def __init__(self, count: int = 4) -> None:
        self.asked: list[Any] = []
        self.count = count

    def command(self, name: str) -> None:
        self.asked.append(name)

    def operate(self, kind: str, body: dict[str, Any], bar: Any) -> Any:
        self.asked.append((kind, *body["targets"]))
        return {}

    def latest_look(self) -> Any:
        return Seen()

    def picture(self) -> bytes:
        return b""

    def now_ns(self) -> int:
        return 5

    def holes(self) -> list[tuple[Array, Array]]:
        return [(np.array([100.0 * k, 50.0]), np.array([0.1 * k, 0.0, 1.0])) for k in range(self.count)]

    def target_at(self, pixel: Array) -> str:
        self.asked.append(tuple(pixel))
        return f"t{len(self.asked)}"


class Seen:
    time_ns = 7
    X_CM = np.eye(4)
    X_CO = np.eye(4)


def truth() -> PlantTruth:
    return Plant(plant_config(), seed=1).truth()


def test_the_three_in_the_middle_are_clicked_and_driven_to_from_left_to_right() -> None:
    rig = StubRig(5)
    with bars(quiet=True) as shown:
        recorder = Recorder(rig, shown)
        visit_holes(rig, recorder)
    assert rig.asked == ["enable", (100.0, 50.0), (200.0, 50.0), (300.0, 50.0),
                         ("visit", "t2"), ("visit", "t3"), ("visit", "t4")]  # fmt: skip
    assert [rest.look_number for rest in recorder.rests] == [1, 2, 3]
    assert [rest.clicked.p_C[0] for rest in recorder.rests if rest.clicked] == pytest.approx([0.1, 0.2, 0.3])
    with bars(quiet=True) as shown, pytest.raises(MeasurementFailed, match="2 holes are seen, 3 are wanted"):
        visit_holes(StubRig(2), Recorder(rig, shown))


def test_every_hole_is_judged_by_the_true_place_nearest_to_its_click() -> None:
    now = truth()
    truths = [TimedTruth(int(1e9 * second), now) for second in range(10)]
    middles = HOLES_O @ now.R_CO.T + now.p_CO
    rests = [
        Rest(f"hole {k}", k, int(1e9 * k * 3), None, "", Picture("", b""), None,
             Clicked(0, middles[hole] + [0.01, -0.01, 0.02]))
        for k, hole in ((1, 1), (2, 2))
    ]  # fmt: skip
    aimed = aimed_truths(truths, rests, HOLES_O)
    moved = [timed.truth.p_CO - now.p_CO for timed in aimed]
    for second, hole in ((0, 1), (3, 1), (4, 2), (6, 2), (9, 2)):
        assert moved[second] == pytest.approx(now.R_CO @ HOLES_O[hole]), second
    assert tool_error(aimed[3].truth, 0.1) == pytest.approx(middles[1] - now.p_CM - [0, 0, 0.1])
    assert aimed_truths(truths, [rests[0]._replace(clicked=None)], HOLES_O) == truths
    ended = stages(rests, aimed, 0.1)
    assert ended[0].true.p_m != pytest.approx(ended[1].true.p_m)


def test_one_hole_outside_fails_the_whole_row() -> None:
    def outcome(*errors_mm: float) -> Outcome:
        base = stages((), [TimedTruth(0, truth())], 0.1)
        assert base == ()
        from testbed.reporting.outcome import Errors, Stage

        made = [Stage(f"hole {k}", k, 1.0, None, Errors(1e-3 * np.array([mm, 0.0, 0.0]), 0.0))
                for k, mm in enumerate(errors_mm, 1)]  # fmt: skip
        return Outcome("lockstep", "drill_face", 1, 3, tuple(made), 1.0, 1.0, {}, every=True)

    assert outcome(1.0, -4.9, 2.0).passed
    assert verdict(outcome(1.0, -4.9, 2.0)).endswith("+1.00/+0.00, -4.90/+0.00, +2.00/+0.00; within ±5 mm")
    assert not outcome(1.0, 5.1, 2.0).passed
    assert "NOT within" in verdict(outcome(1.0, 5.1, 2.0))
    assert not outcome(1.0, 2.0).passed, "the third was not reached"
