"""The suite with a key: a sound controller passes it, and every broken one is caught by its own case."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from conformance.case import CaseOutcome
from conformance.command import app
from conformance.runner import reference_cases, run_reference
from protocol.authentication import LinkKey
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant
from tests.conformance.mutants.key import KEY, KEY_MUTANTS, KeyedController
from tests.conformance.mutants.link_key import LINK_KEY_MUTANTS
from tests.conformance.test_reference_suite import CONTROL, failures

simulated = pytest.mark.usefixtures("network")
FOR_CONTROLLERS_WITHOUT_A_KEY = {722}
OF_AUTHENTICATION = {case.number for case in reference_cases() if 700 < case.number < 800}


def asked_of_a_sound_one(numbers: set[int]) -> None:
    """A sound controller with a key passes these cases."""
    with KeyedController() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=numbers, motion=True, key=KEY)
    assert failures(summary) == []
    assert len(summary.results) == len(numbers)


@simulated
def test_a_sound_controller_with_a_key_passes_the_cases_of_authentication_and_framing() -> None:
    framing = {case.number for case in reference_cases() if case.number < 200}
    asked_of_a_sound_one(framing | OF_AUTHENTICATION - FOR_CONTROLLERS_WITHOUT_A_KEY)


@simulated
@pytest.mark.experiment
def test_a_sound_controller_with_a_key_passes_every_case() -> None:
    numbers = {case.number for case in reference_cases()}
    asked_of_a_sound_one(numbers - FOR_CONTROLLERS_WITHOUT_A_KEY)


@simulated
@pytest.mark.parametrize(
    "mutant", [*KEY_MUTANTS, *LINK_KEY_MUTANTS], ids=lambda m: f"{m.make.__name__}-{m.case}"
)
def test_each_broken_controller_is_caught_by_the_case_meant_for_it(mutant: Mutant) -> None:
    with mutant.make() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=[CONTROL, mutant.case], key=KEY)
    outcomes = {result.case.number: result.outcome for result in summary.results}
    assert outcomes == {CONTROL: CaseOutcome.PASS, mutant.case: CaseOutcome.FAIL}


def test_every_case_of_authentication_is_shown_to_be_able_to_fail() -> None:
    caught = {mutant.case for mutant in (*KEY_MUTANTS, *LINK_KEY_MUTANTS)}
    # 710 and 712 need two faults at once; 720 is refused by its length; 722 is for those without a key.
    assert caught | {710, 712, 720, 722} == OF_AUTHENTICATION
    assert len(reference_cases()) >= 120


@simulated
def test_with_a_key_on_one_side_alone_the_run_says_so_and_asks_nothing() -> None:
    with KeyedController() as controller:
        keyless = run_reference("127.0.0.1", controller.port, numbers=[CONTROL, 704])
        other = run_reference("127.0.0.1", controller.port, numbers=[CONTROL], key=LinkKey(bytes(32)))
    with ControllerUnderTest() as controller:
        keyed = run_reference("127.0.0.1", controller.port, numbers=[CONTROL, 704], key=KEY)
    for summary, cause in (
        (keyless, "link.not_authenticated"),
        (other, "link.unknown_key"),
        (keyed, "link.key_not_configured"),
    ):
        assert summary.ended is not None
        assert (summary.ended.cause, summary.results, summary.passed) == (cause, (), False)
    assert "--key" in str(keyless.ended)


@simulated
def test_without_a_key_the_cases_of_authentication_are_unsupported() -> None:
    with ControllerUnderTest() as controller:
        plain = run_reference("127.0.0.1", controller.port, numbers=[CONTROL, 704, 722])
    assert [r.outcome for r in plain.results] == [CaseOutcome.PASS, CaseOutcome.UNSUPPORTED, CaseOutcome.PASS]


@simulated
def test_the_command_takes_the_key_from_a_file_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_text(bytes(range(32)).hex())
    path.chmod(0o600)
    arguments = ["reference", "--case", "101", "--case", "704", "--key", str(path)]
    with KeyedController() as controller:
        good = CliRunner().invoke(app, [*arguments, "--port", str(controller.port)])
        path.chmod(0o644)
        bad = CliRunner().invoke(app, [*arguments, "--port", str(controller.port)])
    assert good.exit_code == 0, good.output
    assert "2 pass, 0 flaky, 0 fail, 0 unsupported" in good.output
    assert getattr(bad.exception, "cause", "") == "configuration.key_exposed"
