"""Each family of the validation product, as a test; and the product's own arithmetic."""

from pathlib import Path

import pytest

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import NoSettings, perform
from laboratory.validation import known_answers
from laboratory.validation.known_answers import FAMILIES, KNOWN_ANSWERS
from laboratory.validation.ledger import oracle
from laboratory.validation.plant_rig import ValidationCase
from tests.support.paths import CONFIGS

LEAST_CASES = {1: 8, 2: 4, 3: 2, 4: 2, 5: 1, 6: 4, 7: 4, 8: 6, 9: 2, 10: 3, 11: 5, 12: 4, 13: 8, 14: 3, 15: 4,
               16: 3, 17: 1, 18: 3, 19: 4, 20: 4, 21: 12, 22: 4, 23: 7, 24: 3, 25: 6, 26: 4,
               27: 7, 28: 6, 29: 8, 30: 6, 31: 6}  # fmt: skip


@pytest.mark.parametrize("number", FAMILIES)
def test_family_is_inside_its_tolerances(number: int) -> None:
    _, family = FAMILIES[number]
    cases = family(CONFIGS)
    failed = [
        f"{case.name}: expected {case.expected}, got {case.obtained}" for case in cases if not case.passed
    ]
    assert not failed
    assert len(cases) >= LEAST_CASES[number]
    assert all(case.family == number for case in cases)


def test_a_case_passes_only_inside_its_tolerance() -> None:
    case = ValidationCase(1, "x", "m", 1.0, 1.009, 0.01, "made up")
    assert case.passed
    assert not case._replace(obtained=1.011).passed
    assert not case._replace(obtained=0.989).passed
    assert not case._replace(obtained=float("nan")).passed


def test_bounds_are_one_sided() -> None:
    most = ValidationCase(1, "x", "m", 1.0, 0.2, 0.0, "made up", "at_most")
    assert most.passed
    assert not most._replace(obtained=1.1).passed
    assert not most._replace(obtained=float("nan")).passed
    least = most._replace(relation="at_least")
    assert not least.passed
    assert least._replace(obtained=1.0).passed


def test_what_needs_no_oracle_is_validated_and_the_rest_is_said_to_be_left_out(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    case = ValidationCase(1, "right", "m", 1.0, 1.0, 0.1, "geometry")

    def compared(config_dir: Path) -> list[ValidationCase]:
        oracle("no_such_oracle")
        return []

    families = {1: ("geometry", lambda config_dir: [case]), 2: ("accelerations", compared)}
    request = CampaignRequest(CONFIGS, tmp_path, workers=0)
    for chosen, passed in ((families, False), ({1: families[1]}, True)):
        monkeypatch.setattr(known_answers, "FAMILIES", chosen)
        assert perform(KNOWN_ANSWERS, request, NoSettings()) is passed
        assert "1 of 1" in capsys.readouterr().out
