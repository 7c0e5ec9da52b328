"""The first hour: the steps in their order, where one stops, and what is said then."""

import io
import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rich.console import Console
from typer.testing import CliRunner

from conformance.case import CaseOutcome
from conformance.command import app as suites
from conformance.command import print_step, result_line
from conformance.records import COUPLER_STEPS, REFERENCE_STEPS
from conformance.runner import coupler_cases, run_coupler, run_reference
from protocol.datagram_layout import Kind
from protocol.reference_messages import Acknowledgement
from tests.conformance.controllers import ControllerUnderTest, not_passed
from tests.conformance.couplers import ThreadedCoupler

simulated = pytest.mark.usefixtures("network")
PASS, FLAKY, FAIL, UNSUPPORTED = CaseOutcome


OF_A_KEY = {701, 704, 718}


class HalfWritten(ControllerUnderTest):
    """Sends some kinds of datagrams only."""

    sends: tuple[Kind, ...] = ()

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        # Here, so that its datagrams stay numbered one by one.
        return [acknowledgement] if Kind.ACKNOWLEDGEMENT in self.sends else []

    def outgoing(self, data: bytes) -> list[bytes]:
        return [data] if data[6] in self.sends else []


@simulated
def test_a_sound_controller_passes_every_step_in_its_order() -> None:
    with ControllerUnderTest() as controller:
        summary = run_reference("127.0.0.1", controller.port, motion=True, first_hour=True)
    assert not any(result_line(result).rstrip().endswith(":") for result in summary.results)
    said, total = io.StringIO(), len(REFERENCE_STEPS)
    print_step(Console(file=said, width=200), summary, REFERENCE_STEPS)
    assert said.getvalue().startswith(f"{total - 3} of {total} steps pass, 3 were not asked (3: ")
    assert [result.case.number for result in summary.results] == [step.number for step in REFERENCE_STEPS]
    assert set(not_passed(summary)) == OF_A_KEY
    assert summary.passed


@pytest.mark.realtime
@pytest.mark.usefixtures("clock")
def test_a_sound_coupler_passes_every_step_in_its_order() -> None:
    with ThreadedCoupler() as coupler:
        summary = run_coupler("127.0.0.1", coupler.port, outputs=True, first_hour=True)
    assert [result.case.number for result in summary.results] == [step.number for step in COUPLER_STEPS]
    assert not_passed(summary) == {}


@simulated
@pytest.mark.parametrize(
    ("sends", "stops_at"),
    [
        ((), 200),
        ((Kind.WELCOME,), 317),
        ((Kind.WELCOME, Kind.HEARTBEAT_REPLY), 590),
        ((Kind.WELCOME, Kind.HEARTBEAT_REPLY, Kind.STATE), 101),
        ((Kind.WELCOME, Kind.HEARTBEAT_REPLY, Kind.STATE, Kind.ACKNOWLEDGEMENT), 224),
    ],
    ids=lambda value: str(value) if isinstance(value, int) else "",
)
def test_a_controller_stops_at_the_step_of_what_it_does_not_send(
    sends: tuple[Kind, ...], stops_at: int
) -> None:
    with HalfWritten() as controller:
        controller.sends = sends
        summary = run_reference("127.0.0.1", controller.port, motion=True, first_hour=True)
    assert summary.results[-1].case.number == stops_at
    assert summary.results[-1].outcome is CaseOutcome.FAIL
    assert summary.count(CaseOutcome.FAIL) == 1


@simulated
def test_the_command_shows_the_bytes_the_clause_and_what_to_write_next() -> None:
    with HalfWritten() as controller:
        controller.sends = (Kind.WELCOME,)
        done = CliRunner().invoke(suites, ["reference", "--port", str(controller.port), "--first-hour"])
    assert done.exit_code == 1
    said = done.output
    assert "317 (clause 5.5) HEARTBEAT is answered at once" in said
    assert "→ 72 bytes, Hello sequence 1 session 0\n    client_nonce" in said
    assert f"Step 2 of {len(REFERENCE_STEPS)}. To write next: Answer HEARTBEAT at once" in said


# The coupler's suite.


@pytest.mark.realtime
@pytest.mark.usefixtures("clock")
@pytest.mark.slow("a whole suite over sockets")
def test_without_leave_no_case_writes_outputs() -> None:
    with ThreadedCoupler() as coupler:
        summary = run_coupler("127.0.0.1", coupler.port)
        assert coupler.written == []
    assert summary.count(CaseOutcome.FAIL) == 0
    motion = {case.number for case in coupler_cases() if case.motion}
    assert {r.case.number for r in summary.results if r.outcome is CaseOutcome.UNSUPPORTED} == motion


@pytest.mark.realtime
@pytest.mark.usefixtures("clock")
def test_the_command_writes_records_and_ends_with_its_verdict(tmp_path: Path) -> None:
    runner = CliRunner()
    with ThreadedCoupler() as coupler:
        arguments = ["coupler", "--port", str(coupler.port), "--case", "601", "--case", "651"]
        good = runner.invoke(suites, [*arguments, "--out", str(tmp_path)])
    assert good.exit_code == 0, good.output
    assert "1 pass, 0 flaky, 0 fail, 1 unsupported" in good.output
    assert json.loads((tmp_path / "results.json").read_text())["suite"] == "coupler"
    assert ElementTree.parse(tmp_path / "junit.xml").getroot().get("name") == "coupler"
    text = (tmp_path / "transcripts" / "601.txt").read_text()
    assert "000100000006010300000001" in text
    assert "transaction 1 unit 1 function 3" in text
    bad = runner.invoke(suites, arguments)
    assert getattr(bad.exception, "cause", "") == "link.unreachable"
