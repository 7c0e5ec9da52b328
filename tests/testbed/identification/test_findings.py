"""Stages four and five: what a fitted plant is worth, whether it is believed, and its file."""

from pathlib import Path

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from protocol.errors import ConfigurationError
from testbed.cli import identify
from testbed.cli.options import IdentifyOptions
from testbed.identification.excitation import FINE_STEP_MS, Piece, record
from testbed.identification.findings import write_plant_file
from testbed.identification.fit import Identified, Simple, problem_of
from testbed.identification.free_run import measured, predicted
from testbed.identification.operating import PressureFit
from testbed.identification.parameters import base_of, changed, parameters_of
from testbed.identification.recording import Machine, MotionRecording, check_recording
from testbed.identification.shooting import Fit, FitProblem, signals
from testbed.identification.validation import check_believable, check_noise, validate, whiteness

CONFIGS = Path(__file__).parents[3] / "configs"
MACHINE = Machine("an arm", "0123456789abcdef", "servo")
TRUE = {"lift rated flow +": 0.08, "lift deadband −": 0.5, "bulk modulus": 0.12, "lift encoder zero": 1.5}
PIECES = [Piece("rest", (), 0.0, 0.3), Piece("step", (1,), 0.1, 1.0), Piece("mixture", (1,), 0.06, 2.8, 1)]


@pytest.fixture(scope="module")
def file() -> PlantConfig:
    return load(PlantConfig, CONFIGS / "plant.yaml")  # without load: its payload is at its bound


@pytest.fixture(scope="module")
def recorded(file: PlantConfig) -> MotionRecording:
    known = parameters_of(file, [1])
    data = changed(base_of(file), known, np.array([TRUE.get(p.name, 0.0) for p in known]))
    data["step_ms"] = FINE_STEP_MS
    return record(
        PlantConfig.model_validate(data), MACHINE, PIECES, [Piece("mixture", (1,), 0.08, 2.1, 2)], seed=8
    )


@pytest.fixture(scope="module")
def problem(file: PlantConfig, recorded: MotionRecording) -> FitProblem:
    return problem_of(file, recorded, check_recording(recorded, MACHINE))


def found_at(problem: FitProblem, told: dict[str, float], sure: float = 0.02) -> Identified:
    """A fit that ended at ``told``, every parameter of it known to ``sure`` of its prior."""
    theta = np.array([told.get(p.name, 0.0) for p in problem.parameters])
    there = signals(problem, 0.0, theta)
    assert there is not None
    left = measured(problem.recording)[:, list(problem.used)] / problem.std - there
    slopes = np.zeros((left.size, len(theta)))
    slopes[np.arange(len(theta)), np.arange(len(theta))] = 1.0 / (sure * problem.spreads)
    cost = float(np.sum(left**2))
    fit = Fit(
        theta, np.diag((sure * problem.spreads) ** 2), cost, cost, left.size, 1, left, slopes, promised=0.0
    )
    return Identified(problem, [1], Simple([], None, PressureFit(8e8, 1e6, [])), fit)


@pytest.fixture(scope="module")
def true_fit(problem: FitProblem) -> Identified:
    return found_at(problem, TRUE)


def test_the_true_plant_predicts_what_was_held_out(true_fit: Identified, recorded: MotionRecording) -> None:
    told = {signal.signal: signal for signal in validate(true_fit, recorded)}
    assert set(told) == {"lift angle", "lift pressure a", "lift pressure b", "supply pressure"}
    angle = told["lift angle"]
    assert angle.fit > 0.99
    assert angle.before < 0.95
    assert angle.rms_over_noise == pytest.approx(1.0, abs=0.8)  # its start is not fitted here
    assert told["lift pressure a"].fit > 0.9
    check_believable(true_fit, list(told.values()))


def test_a_machine_that_moves_otherwise_than_its_plant_is_refused(
    problem: FitProblem, recorded: MotionRecording
) -> None:
    """As an arm with another cylinder would: half of the flow for the same word."""
    wrong = found_at(problem, {"lift rated flow +": 0.3, "lift rated flow −": -0.3})
    with pytest.raises(ConfigurationError, match=r"lift angle: -?\d+\.\d % of the held-out") as caught:
        check_believable(wrong, validate(wrong, recorded))
    assert caught.value.cause == "identification.not_predicted"


def test_a_fit_that_was_broken_off_is_refused_by_name(
    true_fit: Identified, recorded: MotionRecording
) -> None:
    """All of its numbers may look well, and its motion be predicted: its σ are not those of its errors."""
    signals_of = validate(true_fit, recorded)
    with pytest.raises(ConfigurationError, match=r"would still fall by 84, wanted at most 1:") as caught:
        check_believable(true_fit._replace(whole=true_fit.whole._replace(promised=84.0)), signals_of)
    assert caught.value.cause == "identification.not_converged"
    unknown = true_fit._replace(whole=true_fit.whole._replace(promised=float("nan")))
    with pytest.raises(ConfigurationError, match="still fall by nan"):
        check_believable(unknown, signals_of)


def test_a_fit_that_leaves_more_than_noise_is_refused_by_name(
    true_fit: Identified, recorded: MotionRecording
) -> None:
    white = [signal._replace(white=0.85) for signal in validate(true_fit, recorded)]
    check_noise(white)
    coloured = [*white[:2], white[2]._replace(white=0.3), white[3]]
    with pytest.raises(ConfigurationError, match=r"lift pressure b: 30 % .* wanted 60: .*--unsure") as caught:
        check_noise(coloured)
    assert caught.value.cause == "identification.not_noise"


def _pushed_at_the_bound(true_fit: Identified, by: float) -> Identified:
    """The payload stands at 0 kg, and what is left asks for ``by`` σ less."""
    k = next(k for k, p in enumerate(true_fit.problem.parameters) if p.name == "payload")
    fit = true_fit.whole
    left = fit.residuals.copy()
    left.ravel()[k] = -by  # of the row that tells this parameter
    slopes = fit.jacobian.copy()
    slopes[:, k] = 0.0
    slopes[k, k] = 1.0 / np.sqrt(fit.covariance[k, k])
    return true_fit._replace(whole=fit._replace(residuals=left, jacobian=slopes))


def test_a_machine_without_load_is_legal_but_not_one_that_weighs_less_than_nothing(
    true_fit: Identified, recorded: MotionRecording
) -> None:
    signals_of = validate(true_fit, recorded)
    check_believable(_pushed_at_the_bound(true_fit, 2.0), signals_of)
    with pytest.raises(
        ConfigurationError, match="payload: at 0 kg, and the recording asks for 9 σ"
    ) as caught:
        check_believable(_pushed_at_the_bound(true_fit, 9.0), signals_of)
    assert caught.value.cause == "identification.at_bound"


def test_a_number_far_off_its_prior_is_refused_by_name(
    problem: FitProblem, true_fit: Identified, recorded: MotionRecording
) -> None:
    k = next(k for k, p in enumerate(problem.parameters) if p.name == "lift deadband +")
    theta = true_fit.whole.theta.copy()
    theta[k] = 1.3
    far = true_fit._replace(whole=true_fit.whole._replace(theta=theta))
    with pytest.raises(ConfigurationError, match=r"lift deadband \+: 4.3 spreads of its prior off") as caught:
        check_believable(far, validate(true_fit, recorded))
    assert caught.value.cause == "identification.at_bound"


def test_whiteness_tells_noise_from_what_a_model_left() -> None:
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(2000)
    assert whiteness(noise) > 0.8
    assert whiteness(np.cumsum(noise)) < 0.2
    assert whiteness(np.ones(50)) == 1.0


def test_the_plant_file_loads_and_is_the_plant_that_was_fitted(
    file: PlantConfig, true_fit: Identified, recorded: MotionRecording, tmp_path: Path
) -> None:
    kept = next(k for k, p in enumerate(true_fit.problem.parameters) if p.name == "lift play")
    found = true_fit._replace(whole=true_fit.whole._replace(fixed=(kept,)))
    path = tmp_path / "deep" / "plant_identified.yaml"
    loaded = write_plant_file(path, found, file, recorded._replace(sha256="ab" * 32))
    text = path.read_text()
    assert "sha256 " + "ab" * 32 in text
    assert "bulk_modulus_mpa: 901.997" in text
    assert "# [I ±0.3 %, recording abababababab]" in text
    play = next(line for line in text.splitlines() if "half_width_mrad" in line)
    assert "[I" not in play  # it keeps the file's number
    assert loaded == load(PlantConfig, path)
    assert loaded.step_ms == file.step_ms
    assert loaded.valves.of("lift", 1.0).flow_extend_l_min == pytest.approx(
        file.valves.of("lift", 100.0).flow_extend_l_min * np.exp(0.08)
    )
    assert loaded.valves.of("wrist1", 1.0) == file.valves.of("wrist1", 40.0)._replace(
        actuator_leakage_m3_s_pa=file.actuators.wrist1.leakage_m3_s_pa
    )
    fine = loaded.model_copy(update={"step_ms": true_fit.problem.base["step_ms"]})
    again = predicted(fine, true_fit.problem.recording, true_fit.problem.start)[:, 1]
    there = signals(true_fit.problem, 0.0, true_fit.whole.theta)
    assert there is not None
    assert np.abs(again / true_fit.problem.std[0] - there[:, 0]).max() < 1e-3


@pytest.mark.parametrize(("white", "told"), [(0.3, "[I σ unknown, recording"), (0.9, "[I ±0.3 %, recording")])
def test_what_is_no_noise_is_written_when_asked_for_and_without_spreads(
    true_fit: Identified,
    recorded: MotionRecording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    white: float,
    told: str,
) -> None:
    left = [signal._replace(white=white) for signal in validate(true_fit, recorded)]
    answers = {
        "read_recording": recorded,
        "check_recording": [1],
        "identify": true_fit,
        "validate": left,
    }
    for name, answer in answers.items():
        monkeypatch.setattr(identify, name, lambda *_args, answer=answer: answer)
    path, asked = tmp_path / "plant.yaml", identify.asked_of(CONFIGS, [])
    options = IdentifyOptions(plant_file=path, workers=1)
    if white < 0.5:
        with pytest.raises(ConfigurationError, match="as of noise, wanted 60"):
            identify.run_identify(asked, path, options, 1, None)
        assert not path.exists()
    assert identify.run_identify(asked, path, options._replace(unsure=True), 1, None)
    assert told in path.read_text()
    assert told.split(",", maxsplit=1)[0].replace("0.3 %", "σ") in path.read_text().splitlines()[1]


def test_a_plant_too_stiff_for_the_files_step_is_written_with_the_fits(
    file: PlantConfig, problem: FitProblem, true_fit: Identified, recorded: MotionRecording, tmp_path: Path
) -> None:
    hasty = file.model_copy(update={"step_ms": 0.7})
    loaded = write_plant_file(tmp_path / "stiff.yaml", true_fit, hasty, recorded)
    assert loaded.step_ms == problem.base["step_ms"] == pytest.approx(0.4)
