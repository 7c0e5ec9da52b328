"""The conformance suite, with a key and without: what it asks for, and what a run leaves behind."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from conformance.command import app
from conformance.runner import reference_cases, run_reference
from protocol.authentication import LinkKey
from tests.conformance.controllers import ControllerUnderTest, not_passed
from tests.conformance.mutator import KEY, KeyedController, edited
from tests.support.paths import DOCS

pytestmark = pytest.mark.slow("the suite runs once for every broken controller")

PAGE = DOCS / "protocol.md"
simulated = pytest.mark.usefixtures("network")
CONTROL = 101
FOR_CONTROLLERS_WITHOUT_A_KEY = {722}
OF_AUTHENTICATION = {case.number for case in reference_cases() if 700 < case.number < 800}


@pytest.mark.realtime
def test_on_real_sockets_it_passes_a_case_of_each_subject() -> None:
    numbers = [CONTROL, 136, 224, 301, 313, 401, 509, 521, 541]
    with ControllerUnderTest() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=numbers, motion=True)
    assert not_passed(summary) == {}
    assert len(summary.results) == len(numbers)


# Why no case asks for them; the others are asked for.
NOT_ASKED = {
    **dict.fromkeys(("1.1", "1.2", "1.3", "1.4", "3.8", "3.9", "7.1", "7.2"), "every case rests on it"),
    **dict.fromkeys(("2.1", "2.2", "3.3", "9.2", "11.1"), "without it no case gets an answer"),
    **dict.fromkeys(("2.4", "5.6"), "shows in what 5.3 and 5.5 ask for, or on the client's side"),
    **dict.fromkeys(("4.8", "4.10", "8.1"), "binds the client"),
    **dict.fromkeys(("4.12", "11.11"), "says what is not promised"),
}


def test_every_clause_of_the_link_is_asked_for_or_it_is_said_why_not() -> None:
    written = set(re.findall(r"^\*\*(\d+\.\d+)\*\*", PAGE.read_text(), re.MULTILINE))
    of_the_link = {clause for clause in written if not clause.startswith("10.")}  # 10 is the process image's
    asked = {case.clause for case in reference_cases()}
    assert asked <= written | {"8"}
    assert not asked & set(NOT_ASKED)
    assert of_the_link - set(NOT_ASKED) <= asked


@simulated
def test_the_command_prints_writes_and_ends_with_its_verdict(tmp_path: Path) -> None:
    runner = CliRunner()
    with ControllerUnderTest() as controller:
        port = str(controller.port)
        arguments = ["reference", "--port", port, "--case", "101", "--case", "521"]
        good = runner.invoke(app, [*arguments, "--json", str(tmp_path / "r.json")])
    assert good.exit_code == 0, good.output
    assert "1 pass, 0 flaky, 0 fail, 1 unsupported" in good.output
    assert json.loads((tmp_path / "r.json").read_text())["counts"]["pass"] == 1
    with edited(("datagram", "if magic != MAGIC:", "if False:"))() as broken:
        arguments = ["reference", "--port", str(broken.port), "--case", "102"]
        bad = runner.invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert bad.exit_code == 1
    assert "0 pass, 0 flaky, 1 fail, 0 unsupported" in bad.output
    transcripts = {path.name for path in (tmp_path / "out" / "transcripts").iterdir()}
    assert "102.txt" in transcripts


def asked_of_a_sound_one(numbers: set[int]) -> None:
    """A sound controller with a key passes these cases."""
    with KeyedController() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=numbers, motion=True, key=KEY)
    assert not_passed(summary) == {}
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
