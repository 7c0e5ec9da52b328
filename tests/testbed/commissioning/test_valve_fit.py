"""Valves of drawn faults are found from what the excitation recorded of them."""

import numpy as np
import pytest

from controller.core.excitation.plan import StrokeKind
from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_fit import Floor, RampFits, fit_ramps, loop_of
from testbed.commissioning.ramp_rows import Uncertain
from testbed.commissioning.recording import (
    StrokeRecord,
    air_compressed,
    recording_of,
    strokes_in,
)
from testbed.commissioning.valve_fit import EdgeFindings, edge_findings
from tests.controller.excitation.toy_valve import ToyValve, arm, plan_for, tried


def strokes_of(valve: ToyValve) -> list[StrokeRecord]:
    plan = plan_for(valve.joint)
    _, failure, samples = tried(valve, plan)
    assert failure is None
    return strokes_in(recording_of(arm(), valve.joint, plan.strokes, samples), compensated=False)


def first_rows(stroke: StrokeRecord, count: int) -> StrokeRecord:
    series = [name for name, values in stroke._asdict().items() if isinstance(values, np.ndarray)]
    return stroke._replace(**{name: getattr(stroke, name)[:count] for name in series})


def honest(found: Uncertain, true: float, most: float = 3.5) -> bool:
    return abs(found.value - true) <= most * found.std


@pytest.mark.parametrize("seed", range(4))
def test_drawn_valves_are_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    deadband = rng.uniform(0.004, 0.12)
    lower = deadband * rng.uniform(0.7, 1.3)
    play, gain = rng.uniform(0.0, 0.6) * min(deadband, lower), rng.uniform(0.7, 1.4)
    valve = ToyValve(5, deadband, lower, play, gain, delay_s=rng.uniform(0.0, 0.1), seed=seed)
    strokes = strokes_of(valve)
    for sense, true in ((1.0, deadband), (-1.0, lower)):
        found: EdgeFindings = edge_findings(strokes, sense)
        assert found.deadband.value == pytest.approx(true, rel=0.03, abs=1e-4)
        assert honest(found.deadband, true)
        assert honest(found.hysteresis, play)
        assert found.lag.value == pytest.approx(valve.delay_s, abs=0.015)
        assert found.gain.value == pytest.approx(gain, rel=0.04)


def test_a_load_that_runs_ahead_is_metered_by_its_outlet() -> None:
    """The chamber to be filled stands at the tank's pressure, and its edge says nothing of the motion."""
    strokes = [
        stroke._replace(
            e=stroke.e * (1.0 + 0.3 * stroke.t),
            inlet=np.full_like(stroke.t, 10.0),
            fed_bar=np.zeros_like(stroke.t),
            e_by_outlet=stroke.e,
        )
        for stroke in strokes_of(ToyValve(5, 0.05, 0.06, gain=1.2))
    ]
    found = edge_findings(strokes, 1.0)
    assert found.by_outlet
    assert found.deadband.value == pytest.approx(0.05, rel=0.02)
    share = np.median(strokes[4].e_by_outlet / strokes[4].e)
    assert 0.3 * share < found.gain.value < 3.0 * share
    filled = [stroke._replace(fed_bar=np.full_like(stroke.t, 20.0)) for stroke in strokes]
    pushed = edge_findings(filled, 1.0)
    assert pushed.last == "return"
    assert pushed.deadband.value == pytest.approx(0.05, rel=0.02)


def test_a_load_that_runs_ahead_at_small_openings_alone_is_metered_by_its_inlet_beyond() -> None:
    """A nearly balanced wrist: let go by its outlet at first, pushed by its inlet from an opening on."""
    strokes = strokes_of(ToyValve(5, 0.07, 0.06, play=0.02, outlet_at=0.062, outlet_gain=0.35))
    assert any(np.any(stroke.fed_bar < 1.0) for stroke in strokes)
    found = edge_findings(strokes, 1.0)
    assert not found.by_outlet
    assert found.residual < 4.0e-5
    assert found.deadband.value == pytest.approx(0.07, rel=0.02)
    assert honest(found.deadband, 0.07)
    assert found.hysteresis.value == pytest.approx(0.02, rel=0.05)


def test_what_all_ramps_share_is_in_the_loop_once() -> None:
    """Reaching from two rates to rate 0 multiplies what differs between ramps, not what they share."""
    found = edge_findings(strokes_of(ToyValve(5, 0.10, 0.10, play=0.03)), 1.0)
    shared = 2.0e-5  # as is stated of valves whose flow depends on the load
    assert shared <= found.hysteresis.std < 1.3 * shared


def test_an_outlet_with_a_few_bar_left_is_laminar() -> None:
    """So is its flow, in proportion to the pressure: taken for turbulent, the rim would be misplaced."""
    strokes = []
    for stroke in strokes_of(ToyValve(5, 0.05, 0.06)):
        drop = 1.5 + 6.0 * np.exp(-stroke.t)  # bar
        turbulent = stroke.e / np.sqrt(drop / np.hypot(drop, 3.0))
        outlet = stroke.inlet - stroke.fed_bar + drop
        tank = stroke._replace(inlet=stroke.inlet - stroke.fed_bar, fed_bar=np.zeros_like(stroke.t))
        strokes.append(tank._replace(e_by_outlet=turbulent, outlet=outlet))
    found = edge_findings(strokes, 1.0)
    assert found.by_outlet
    assert found.deadband.value == pytest.approx(0.05, rel=0.01)
    assert honest(found.deadband, 0.05)


def test_a_load_that_swings_on_its_oil_is_told_by_the_flow() -> None:
    """Speed and pressure swing against each other: the flow of the two together does not."""
    strokes = []
    for stroke in strokes_of(ToyValve(5, 0.05, 0.05, play=0.03)):
        swing = 20.0 * np.sin(2.0 * np.pi * 1.4 * stroke.t) * (stroke.turned > 1e-3)
        strokes.append(stroke._replace(turned=stroke.turned - 3e-4 * swing, inlet=stroke.inlet + swing))
    found = edge_findings(strokes, 1.0)
    assert found.deadband.value == pytest.approx(0.05, rel=0.02)
    assert found.hysteresis.value == pytest.approx(0.03, rel=0.1)


def test_air_in_the_oil_is_not_taken_for_deadband() -> None:
    """A slew's chambers stand a few bar above the tank, where air makes the oil softer the less they bear:
    taken for stiff, rising ramps seemed to begin late, and the loop seemed wider (machines 41893, 41905)."""
    strokes = []
    for stroke in strokes_of(ToyValve(5, 0.05, 0.06, play=0.02)):
        inlet = 12.0 + 12.0 * (1.0 - np.exp(-stroke.turned / 0.02))
        air = air_compressed(inlet)
        swallowed = 6e-4 * (inlet - inlet[0]) + 0.048 * (air - air[0])
        strokes.append(stroke._replace(turned=stroke.turned - swallowed, inlet=inlet, air=air))
    for sense, true in ((1.0, 0.05), (-1.0, 0.06)):
        found = edge_findings(strokes, sense)
        assert found.deadband.value == pytest.approx(true, abs=5e-5)
        assert found.hysteresis.value == pytest.approx(0.02, abs=1e-4)
        blind = edge_findings([stroke._replace(air=np.zeros_like(stroke.t)) for stroke in strokes], sense)
        assert abs(blind.deadband.value - true) > 1e-4


def test_oil_that_moves_an_actuator_within_its_play_is_left_out() -> None:
    """It is flow that neither presses nor turns the encoder: the ramp's first rows are not the model's."""
    strokes = []
    for stroke in strokes_of(ToyValve(5, 0.05, 0.05, play=0.03)):
        pressing = np.minimum(stroke.turned, 3e-3)
        crossed = np.clip(stroke.turned - 3e-3, 0.0, 6e-4)
        turned, inlet = stroke.turned - pressing - crossed, stroke.inlet + pressing / 3e-4
        strokes.append(stroke._replace(turned=turned, inlet=inlet))
    found = edge_findings(strokes, 1.0)
    assert found.residual < 2.5e-5
    assert found.deadband.value == pytest.approx(0.05, abs=1e-4)
    assert found.hysteresis.value == pytest.approx(0.03, abs=2e-4)


def test_a_ramp_that_hardly_fell_tells_by_its_rising_half() -> None:
    strokes = strokes_of(ToyValve(5, 0.05, 0.06, play=0.02))
    cut = [k for k, s in enumerate(strokes) if s.kind is StrokeKind.RAMP and s.sense > 0.0][-1]
    strokes[cut] = first_rows(strokes[cut], strokes[cut].top + 12)
    found = edge_findings(strokes, 1.0)
    assert found.deadband.value == pytest.approx(0.05, rel=0.01)
    assert found.hysteresis.value == pytest.approx(0.02, rel=0.02)


def test_a_rim_counts_as_much_as_its_rows_tell_of_it() -> None:
    """A falling ramp of 0.2 s misses its rim by 1e-3: it is known to be that unsure."""
    ways, rates = np.array([1.0, 1.0, -1.0, -1.0, -1.0]), np.array([0.01, 0.02, 0.01, 0.02, 0.01])
    rims = 0.05 + ways * (0.5 * 0.02 + rates * 0.07)
    rims[-1] += 1e-3
    stds = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-3])
    told = RampFits(Uncertain(1.0, 0.01), 0.0, 0.0, rims, ways, rates, np.diag(stds**2), 2e-5)
    loop = loop_of(told, Floor(0.0, 0.0))
    assert honest(loop.deadband, 0.05)
    assert loop.deadband.value == pytest.approx(0.05, abs=1e-6)
    assert loop.hysteresis.value == pytest.approx(0.02, abs=1e-6)
    assert loop.lag.value == pytest.approx(0.07, abs=1e-4)
    sure = loop_of(told._replace(covariance=np.diag(np.full(5, 1e-10))), Floor(0.0, 0.0))
    assert sure.deadband.std > 5.0 * loop.deadband.std  # scatter that its rows do not explain widens all


def test_one_pace_is_refused() -> None:
    strokes = [
        s
        for s in strokes_of(ToyValve(5))
        if s.kind is not StrokeKind.RAMP or np.diff(s.u[:50]).max() < 1.5e-4
    ]
    with pytest.raises(MeasurementFailed) as raised:
        edge_findings(strokes, 1.0)
    assert raised.value.cause == "measurement.one_pace"


def test_a_ramp_that_hardly_moved_is_refused() -> None:
    ramp = next(stroke for stroke in strokes_of(ToyValve(5)) if stroke.kind is StrokeKind.RAMP)
    with pytest.raises(MeasurementFailed) as raised:
        fit_ramps([first_rows(ramp, ramp.top + 12)])
    assert raised.value.cause == "measurement.ramp_too_short"
