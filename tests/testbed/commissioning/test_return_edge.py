"""The return edge is found by the pressure of the emptied chamber, or said not to be seen."""

import numpy as np
import pytest

from controller.core.excitation.plan import StrokeKind
from testbed.commissioning.findings import valve_edge
from testbed.commissioning.ramp_fit import Loop, integral
from testbed.commissioning.ramp_rows import Uncertain
from testbed.commissioning.recording import Array, StrokeRecord
from testbed.commissioning.return_edge import ReturnEdge, between, holds_back, meets, return_edge
from testbed.commissioning.valve_fit import EdgeFindings

HYSTERESIS, LAG_S, SUPPLY, RETURN = 0.04, 0.06, 0.07, 0.085
GAIN, COMPLIANCE = 1.2, 6e-4  # of the outlet; rad/bar
LOOP = Loop(Uncertain(SUPPLY, 5e-5), Uncertain(HYSTERESIS, 1e-4), Uncertain(LAG_S, 2e-3))


def falling(pace: float, rng: np.random.Generator, held: float = 0.0) -> StrokeRecord:
    """A triangle at 0.01/s times ``pace`` whose outlet passes what its edge and oil let through.

    ``held``: how much a second throttle in series, which opens with time, takes of the flow at first.
    """
    rate, dt = 0.01 * pace, 0.005
    up = np.arange(0.10, 0.14, rate * dt)
    down = np.arange(0.14 - HYSTERESIS, 0.02, -rate * dt)
    u = np.concatenate([up, down])
    t = dt * np.arange(len(u))
    spool = np.where(
        np.arange(len(u)) < len(up), u - HYSTERESIS / 2 - rate * LAG_S, u + HYSTERESIS / 2 + rate * LAG_S
    )
    outlet = 40.0 + 30.0 * np.clip((0.115 - spool) / 0.04, 0.0, 1.0) + np.sin(9.0 * t)
    e = 1.2 * np.sqrt(outlet / 50.0)
    flow = GAIN * e * np.maximum(spool - RETURN, 0.0) * (1.0 - held * np.sin(2.0 * t) ** 2)
    turned = integral(t, flow) + COMPLIANCE * (outlet - outlet[0])
    zero = np.zeros_like(t)
    return StrokeRecord(
        kind=StrokeKind.RAMP, sense=1.0, t=t, u=u, turned=turned + rng.normal(0.0, 1.5e-5, len(t)), e=zero,
        inlet=outlet, top=len(up), nominal=np.full_like(t, 1.2), e_by_outlet=e,
        outlet=outlet, fed_bar=outlet, air=zero,
    )  # fmt: skip


def ramps(seed: int, held: float = 0.0) -> list[StrokeRecord]:
    rng = np.random.default_rng(seed)
    return [falling(pace, rng, held) for pace in (1.0, 2.0, 1.0, 2.0)]


@pytest.mark.parametrize("seed", range(3))
def test_the_edge_is_found_where_the_joint_ceases_to_move(seed: int) -> None:
    found = return_edge(ramps(seed), LOOP, 0.0)
    assert found is not None
    assert abs(found.opens.value - RETURN) < 3.0 * found.opens.std < 1e-3
    assert found.gain == pytest.approx(GAIN, rel=0.05)


def test_a_loop_that_is_off_shows_in_the_spread() -> None:
    wide = return_edge(ramps(1), LOOP._replace(hysteresis=Uncertain(HYSTERESIS, 4e-3)), 0.0)
    assert wide is not None
    assert wide.opens.std > 2e-3


def test_a_throttle_in_series_is_not_taken_for_the_edge() -> None:
    strokes = ramps(1, held=0.8)
    assert return_edge(strokes, LOOP, 0.0) is None
    assert holds_back(strokes)
    moves: Array = np.array([stroke.u.max() for stroke in strokes])
    found = between(strokes, LOOP)
    assert SUPPLY < found.value < moves.min()
    assert abs(found.value - RETURN) < 2.0 * found.std


def test_the_supply_edge_meters_again_where_the_return_edge_would_pass_as_much() -> None:
    wide = ReturnEdge(Uncertain(RETURN, 1e-4), gain=0.6, drop=1.0)
    assert meets(0.015, wide, 0.2) == pytest.approx(0.0075)
    assert meets(0.015, wide, 0.7) == 0.015


def test_the_file_says_which_edge_opens_last_and_follows_both() -> None:
    """Steep from the return edge on, then as the supply edge has it, which opened earlier."""
    some = Uncertain(0.05, 1e-3)
    found = EdgeFindings(
        Uncertain(RETURN, 1e-4), some, some, gain=Uncertain(0.2, 2e-3), curvature=0.7, residual=2e-5,
        last="return", gap=0.015, meets=0.006,
    )  # fmt: skip
    edge = valve_edge(found, 0.06, "tilt.npz 0123")
    assert edge.deadband.recording == "tilt.npz 0123, by its return edge, which opens last"
    beyond = np.array(edge.curve)
    supply = beyond[:, 0] + found.gap
    assert beyond[0, 0] == found.meets
    assert np.allclose(beyond[:, 1], supply + 0.7 * supply**2)
    slopes = np.diff(np.vstack([[0.0, 0.0], beyond]), axis=0)
    assert slopes[0, 1] / slopes[0, 0] > 2.0 * slopes[1, 1] / slopes[1, 0]
    one = valve_edge(found._replace(last="unknown", gap=0.0, meets=0.0, curvature=0.0), 0.06, "tilt.npz")
    assert one.curve == ()
    assert "one edge seen" in one.deadband.recording
