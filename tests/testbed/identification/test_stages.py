"""The stages of identification against plants whose numbers are known."""

from pathlib import Path

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from protocol.errors import ConfigurationError
from testbed.identification.compiled_run import drive_of
from testbed.identification.excitation import FINE_STEP_MS, Piece, record
from testbed.identification.fit import identify, problem_of, simple_stages
from testbed.identification.free_run import measured, predicted, start_of
from testbed.identification.operating import file_model, operating
from testbed.identification.parameters import base_of, changed, parameters_of
from testbed.identification.recording import Machine, MotionRecording, check_recording
from testbed.identification.shooting import DAMPINGS, FitProblem, Plan, jacobian, shoot, signals
from testbed.identification.validation import check_believable, check_noise, validate

pytestmark = pytest.mark.slow("plants are identified")

CONFIGS = Path(__file__).parents[3] / "configs"
MACHINE = Machine("an arm", "0123456789abcdef", "servo")
TRUE = {
    "bulk modulus": 0.1,
    "payload": 25.0,
    "valve delay": 0.2,
    "lift rated flow +": -0.09,
    "lift rated flow −": 0.06,
    "lift deadband +": 0.4,
    "lift deadband −": -0.2,
    "lift Coulomb": -0.25,
}
PIECES = [
    Piece("rest", (), 0.0, 0.4),
    Piece("ramp", (1,), 0.04, 2.0),
    Piece("step", (1,), 0.15, 1.0),
    Piece("mixture", (1,), 0.03, 1.2, 1),
]


@pytest.fixture(scope="module")
def file() -> PlantConfig:
    return load(PlantConfig, CONFIGS / "plant.yaml", {"payload": {"mass_kg": 40.0}})


@pytest.fixture(scope="module")
def recorded(file: PlantConfig) -> MotionRecording:
    known = parameters_of(file, [1])
    data = changed(base_of(file), known, np.array([TRUE.get(p.name, 0.0) for p in known]))
    data["step_ms"] = FINE_STEP_MS
    true_plant = PlantConfig.model_validate(data)
    return record(true_plant, MACHINE, PIECES, [Piece("mixture", (1,), 0.1, 2.1, 2)], seed=5)


@pytest.fixture(scope="module")
def problem(file: PlantConfig, recorded: MotionRecording) -> FitProblem:
    return problem_of(file, recorded, check_recording(recorded, MACHINE))


def truth(problem: FitProblem) -> np.ndarray:
    return np.array([TRUE.get(p.name, 0.0) for p in problem.parameters])


def test_the_true_plant_leaves_noise_alone(problem: FitProblem) -> None:
    """The run from the measured start is the likelihood: at the truth, noise alone is left."""
    found = signals(problem, 0.0, truth(problem))
    assert found is not None
    left = measured(problem.recording)[:, list(problem.used)] / problem.std - found
    assert np.sqrt(np.mean(left**2, axis=0)) == pytest.approx(1.0, abs=0.25)


def test_simple_stages_find_dead_zones_flows_oil_and_load(problem: FitProblem) -> None:
    simple = simple_stages(problem, [1])
    file = problem.base["valves"]["joints"]["lift"]["deadband"]
    assert [zone.name for zone in simple.dead_zones] == ["lift +", "lift −"]
    for zone in simple.dead_zones:
        edge = "supply_a" if zone.way > 0 else "supply_b"
        expected = file[edge] * np.exp(TRUE[f"lift deadband {zone.name[-1]}"])
        assert zone.deadband == pytest.approx(expected, abs=0.0012), zone.name
    (flow,) = simple.pressures.flows
    assert flow.extend == pytest.approx(np.exp(TRUE["lift rated flow +"]), rel=0.03)
    assert flow.retract == pytest.approx(np.exp(TRUE["lift rated flow −"]), rel=0.03)
    assert simple.pressures.modulus == pytest.approx(800e6 * np.exp(TRUE["bulk modulus"]), rel=0.03)
    assert simple.balance is not None
    assert simple.balance.more_kg == pytest.approx(TRUE["payload"], abs=10.0)
    (friction,) = simple.balance.frictions
    assert friction.coulomb == pytest.approx(4000.0 * np.exp(TRUE["lift Coulomb"]), rel=0.5)


@pytest.mark.timeout(600)  # 40 runs of the plant
def test_shooting_finds_the_plant_and_says_how_sure_it_is(problem: FitProblem) -> None:
    """Three parameters, all others as they are: each within four σ of the truth, from far off."""
    free = ["payload", "lift rated flow +", "lift deadband +"]
    names = [p.name for p in problem.parameters]
    held = frozenset(k for k, name in enumerate(names) if name not in free and "pressure" not in name)
    begin = truth(problem)
    begin[[k for k in range(len(begin)) if k not in held]] = 0.0
    windows = shoot(problem, begin, Plan(0.5, 2, 2, DAMPINGS[:2], 0.2, held))
    whole = shoot(problem, windows.theta, Plan(0.0, 3, 2, DAMPINGS[:2], 1e-6, held))
    stds = np.sqrt(np.diag(whole.covariance))
    for k, parameter in enumerate(problem.parameters):
        if k in held:
            assert whole.theta[k] == begin[k]
            continue
        assert abs(whole.theta[k] - TRUE.get(parameter.name, 0.0)) < 4.0 * stds[k], parameter.name
        assert parameter.of_start or stds[k] < 0.1 * parameter.spread, parameter.name
    assert whole.data / whole.samples == pytest.approx(1.0, abs=0.3)


def test_sensitivities_do_not_depend_on_the_step(problem: FitProblem) -> None:
    """Central differences of a tenth of the step agree with the columns to a thousandth of their size."""
    at = truth(problem)
    found = signals(problem, 0.0, at)
    assert found is not None
    for name in ("lift rated flow +", "valve delay"):
        k = next(k for k, p in enumerate(problem.parameters) if p.name == name)
        steps = np.zeros(len(at))
        steps[k] = 1e-3 * problem.spreads[k]
        forward = jacobian(problem, 0.0, at, found, steps)[:, k]
        low, high = at.copy(), at.copy()
        low[k] -= 0.1 * steps[k]
        high[k] += 0.1 * steps[k]
        below, above = signals(problem, 0.0, low), signals(problem, 0.0, high)
        assert below is not None
        assert above is not None
        central = (above - below).ravel() / (0.2 * steps[k])
        assert np.linalg.norm(forward - central) < 0.01 * np.linalg.norm(central), name


@pytest.mark.timeout(600)  # 80 runs of the plant
def test_what_the_model_lacks_is_not_taken_for_other_numbers(
    file: PlantConfig, recorded: MotionRecording
) -> None:
    """A transducer that reads 0.3 % too much: payload, masses, tilts were off by up to 11 σ, and believed."""
    pressures = recorded.pressures.copy()
    pressures[:, 1, 0] *= 1.003
    wrong = recorded._replace(pressures=pressures)
    found = identify(file, wrong, check_recording(wrong, MACHINE))
    signals_of = validate(found, wrong)
    check_believable(found, signals_of)  # it is at its minimum, inside its priors, and predicts motion
    with pytest.raises(ConfigurationError, match="lift pressure a: ") as caught:
        check_noise(signals_of)
    assert caught.value.cause == "identification.not_noise"


def test_a_delay_is_told_to_a_microsecond(
    file: PlantConfig, problem: FitProblem, recorded: MotionRecording
) -> None:
    """Of a plant that takes words at its own steps, by one whose steps the delay does not fit."""
    known = parameters_of(file, [1])
    data = changed(base_of(file), known, np.array([TRUE.get(p.name, 0.0) for p in known]))
    pressures = []
    for step_ms, delay_ms in ((0.1, 1.3), (0.3125, 1.3), (0.3125, 1.4)):
        data["step_ms"] = step_ms
        data["valves"]["joints"]["lift"]["delay_ms"] = delay_ms
        config = PlantConfig.model_validate(data)
        pressures.append(predicted(config, recorded.part(0.0, 2.9), problem.start)[:, 8:10])
    fine, same, later = pressures
    assert np.abs(later - same).max() > 5e3  # Pa, for 100 µs
    assert np.abs(same - fine).max() < 0.03 * np.abs(later - same).max()


def test_hysteresis_is_the_plants_own(file: PlantConfig) -> None:
    """Words with the loop taken in beforehand move the plant's spool as its own play does."""
    valves = {"joints": {"lift": {"hysteresis": 0.03}}}
    config = load(
        PlantConfig, CONFIGS / "plant.yaml", {"valves": valves, "errors": {"encoder_noise": {"rms_lsb": 0.0}}}
    )
    told = record(config.model_copy(update={"step_ms": 0.3125}), MACHINE, PIECES[:2], [], seed=1)
    config = PlantConfig.model_validate(base_of(config))
    left = predicted(config, told, start_of(told)) - measured(told)
    assert np.abs(left[:, 1]).max() < 60e-6  # rounding, and the noise of the pressures that it began with
    words = np.array([[0.0, 0.1, 0, 0, 0, 0], [0.0, 0.08, 0, 0, 0, 0], [0.0, 0.0, 0, 0, 0, 0]])
    short = told.part(0.0, 0.03)._replace(valves=words)
    np.testing.assert_allclose(drive_of(config).along(short).held[:, 1], [0.085, 0.085, 0.015])


def test_the_first_stage_moves_spools_through_their_loop_and_at_their_rate(file: PlantConfig) -> None:
    """The word is out at once: the spool comes at its rate, and stays short of it by half of the loop."""
    base = base_of(file)
    base["valves"]["joints"]["lift"] |= {
        "hysteresis": 0.02,
        "slew_limit_per_s": {"out": 1.0, "back": 2.0},
        "bandwidth_hz": 50.0,
        "delay_ms": 0.0,
    }
    out, back = Piece("step", (1,), 0.1, 1.0), Piece("rest", (), 0.0, 0.5)
    told = record(file, MACHINE, [back, out], [], seed=1)
    spool = operating(base, file_model(base), told, 1).spool
    begins = 0.5
    at = np.interp(begins + np.array([0.05, 0.25, 0.31, 0.45]), told.time_s, spool)
    assert 0.04 < at[0] < 0.05  # 50 ms of its rate, less the lag of 50 Hz
    assert 0.07 < at[2] < 0.085  # 10 ms of its way back
    np.testing.assert_allclose(at[[1, 3]], [0.09, 0.01], atol=0.001)  # either side of the loop
