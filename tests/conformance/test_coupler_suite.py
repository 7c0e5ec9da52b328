"""The coupler's suite: what a run writes, and what it leaves behind."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from conformance.case import CaseOutcome
from conformance.command import app
from conformance.records import write_records
from conformance.runner import coupler_cases, run_coupler
from tests.conformance.coupler.page_coupler import PageServer
from tests.conformance.coupler.rules import Rules
from tests.conformance.couplers import ShiftedClock, ThreadedCoupler

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("clock")]


@pytest.mark.slow("a whole suite over sockets")
def test_without_leave_no_case_writes_outputs() -> None:
    with ThreadedCoupler() as coupler:
        summary = run_coupler("127.0.0.1", coupler.port)
        assert coupler.written == []
    assert summary.count(CaseOutcome.FAIL) == 0
    motion = {case.number for case in coupler_cases() if case.motion}
    assert {r.case.number for r in summary.results if r.outcome is CaseOutcome.UNSUPPORTED} == motion


def test_the_command_writes_records_and_ends_with_its_verdict(tmp_path: Path) -> None:
    runner = CliRunner()
    with ThreadedCoupler() as coupler:
        arguments = ["coupler", "--port", str(coupler.port), "--case", "601", "--case", "651"]
        good = runner.invoke(app, [*arguments, "--out", str(tmp_path)])
    assert good.exit_code == 0, good.output
    assert "1 pass, 0 flaky, 0 fail, 1 unsupported" in good.output
    assert json.loads((tmp_path / "results.json").read_text())["suite"] == "coupler"
    assert ElementTree.parse(tmp_path / "junit.xml").getroot().get("name") == "coupler"
    text = (tmp_path / "transcripts" / "601.txt").read_text()
    assert "000100000006010300000001" in text
    assert "transaction 1 unit 1 function 3" in text
    bad = runner.invoke(app, arguments)
    assert getattr(bad.exception, "cause", "") == "link.unreachable"


def test_records_of_a_failure_name_it(tmp_path: Path, clock: ShiftedClock) -> None:
    refuses_under_0x80 = Rules(refusal=lambda _, code: bytes([0x80, code]))
    with PageServer(refuses_under_0x80, clock) as coupler:
        write_records(run_coupler("127.0.0.1", coupler.port, numbers=[612]), tmp_path)
    failure = ElementTree.parse(tmp_path / "junit.xml").getroot().find("testcase/failure")
    assert failure is not None
    assert "wanted 8303" in (failure.get("message") or "")
