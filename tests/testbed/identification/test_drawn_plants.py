"""What the experiment on drawn plants counts: as the command refuses, and what was wrong and not refused."""

from types import SimpleNamespace
from typing import Any

import pytest

from laboratory.campaigns.experiment import Check, Finished
from laboratory.experiments.robustness import identification as drawn_plants
from laboratory.experiments.robustness.identification import DrawSettings, IdentifiedRow, draw_verdict
from protocol.errors import ConfigurationError
from tests.support.paths import CONFIGS

GOOD = IdentifiedRow(1, 36, 35, 1.0, 0, 2.5, "lift play", 1.0, 0.9985, -0.5, 140, 0.1, 0.9, cpu_s=60.0)


def _check(rows: list[IdentifiedRow], named: str) -> Check:
    nothing: Any = None
    done = Finished(nothing, DrawSettings(), [], rows, 0)
    return next(check for check in draw_verdict(done) if check.what == named)


def test_a_plant_that_is_wrong_by_its_own_covariance_is_counted() -> None:
    """As one of twenty was: all else of its row looks well."""
    wrong = GOOD._replace(nees=14.9, outside=9, worst="boom mass", worst_sigma=9.1)
    assert _check([GOOD], "wrong and not refused").met
    assert not _check([GOOD, wrong], "wrong and not refused").met


def test_a_refused_plant_is_not_identified_and_not_wrong() -> None:
    refused = GOOD._replace(nees=float("nan"), failure="identification.not_converged: …")
    assert not _check([GOOD, refused], "plants identified").met
    assert _check([GOOD, refused], "wrong and not refused").met


def test_the_experiment_refuses_what_the_command_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    broken_off: Any = SimpleNamespace(whole=SimpleNamespace(promised=84.0, cost=11719.0))
    answers: dict[str, Any] = {"record": None, "check_recording": [0], "identify": broken_off, "validate": []}
    for name, answer in answers.items():
        monkeypatch.setattr(drawn_plants, name, lambda *_args, answer=answer: answer)
    with pytest.raises(ConfigurationError) as caught:
        drawn_plants.identified_plant(CONFIGS, {"seed": 1, "valve_set": "servo"})
    assert caught.value.cause == "identification.not_converged"
