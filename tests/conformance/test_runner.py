"""The runner: who is not there, what is asked twice, profiles, and what is written of it."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from conformance.case import CaseOutcome, Summary
from conformance.parts import OptionalPart, profile_from
from conformance.peer import Peer
from conformance.records import write_records
from conformance.runner import EXCUSED_MS, run_coupler, run_reference
from conformance.wire import NonceSource
from protocol.errors import ConfigurationError
from protocol.server_session import ReferenceServer
from testbed.cli.main import app
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest, shipped_arm_hash
from tests.conformance.couplers import ThreadedCoupler

simulated = pytest.mark.usefixtures("network")
CONTROL, COUPLER_CONTROL, STREAM, PATH, KEYLESS, MOVES = 101, 601, 541, 424, 722, 521
PASS, FLAKY, FAIL, UNSUPPORTED = CaseOutcome


def outcomes(summary: Summary) -> dict[int, CaseOutcome]:
    """Outcome by number."""
    return {result.case.number: result.outcome for result in summary.results}


def ended(summary: Summary) -> str:
    """Why the run broke off."""
    assert summary.ended is not None
    assert not summary.passed
    return summary.ended.cause


# Nobody there.


@contextmanager
def silent_udp_port() -> Iterator[int]:
    """A port that takes datagrams and answers none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bound:
        bound.bind(("127.0.0.1", 0))
        yield bound.getsockname()[1]


def closed_udp_port() -> int:
    """A port at which nobody listens."""
    with silent_udp_port() as port:
        return port


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looks that give up soon."""
    monkeypatch.setattr("conformance.subjects.LOOK_MS", 300)


def one_line(*arguments: str) -> str:
    """What stderr says of a run that ends with status 2."""
    done = CliRunner().invoke(app, ["conformance", *arguments])
    assert done.exit_code == 2, done.output
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    return done.stderr


@pytest.mark.realtime
def test_nobody_at_the_port_is_one_line_and_status_2(brief: None) -> None:
    port = str(closed_udp_port())
    assert "link.unreachable" in one_line("reference", "--port", port)
    assert "link.unreachable" in one_line("coupler", "--port", port)
    with silent_udp_port() as silent:
        assert "link.no_answer" in one_line("reference", "--port", str(silent))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        assert "link.no_answer" in one_line("coupler", "--port", str(listening.getsockname()[1]))


@pytest.mark.slow("the suite runs over and over")
@simulated
def test_a_session_of_another_client_is_found_before_the_first_case() -> None:
    with ControllerUnderTest() as controller:
        other = Peer("127.0.0.1", controller.port, NonceSource(7))
        other.open(period_ms=60_000)
        beat = controller.turn

        def turn() -> None:
            other.beat()
            beat()

        controller.turn = turn  # type: ignore[method-assign]
        summary = run_reference("127.0.0.1", controller.port, numbers=[CONTROL])
        assert ended(summary) == "link.session_occupied"
        assert summary.results == ()
        other.alive("the other client did not notice")
        controller.turn = beat  # type: ignore[method-assign]
        assert outcomes(run_reference("127.0.0.1", controller.port, numbers=[CONTROL])) == {CONTROL: PASS}


@simulated
def test_a_controller_that_goes_midway_ends_the_run_and_leaves_what_is_known(tmp_path: Path) -> None:
    class GoesAtAPath(ControllerUnderTest):
        """Falls over an empty path."""

        def incoming(self, data: bytes) -> bytes | None:
            if data[6] == 6:
                self._socket.close()
            return data

    with GoesAtAPath() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=[CONTROL, PATH, 432])
    assert ended(summary) == "link.unreachable"
    assert outcomes(summary) == {CONTROL: PASS, PATH: FAIL}
    assert f"after case {PATH}" in str(summary.ended)
    write_records(summary, tmp_path)
    written = json.loads((tmp_path / "results.json").read_text())
    assert (written["verdict"], written["ended"]["cause"]) == ("ended", "link.unreachable")
    suite = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert [suite.get(name) for name in ("tests", "failures", "errors")] == ["3", "1", "1"]
    assert suite.find("testcase/error") is not None


@pytest.mark.realtime
def test_outputs_of_another_master_are_found_before_the_first_case(brief: None) -> None:
    with (
        ThreadedCoupler() as coupler,
        socket.create_connection(("127.0.0.1", coupler.port), timeout=2.0) as owner,
    ):
        for request in ("06 1120 0000", "06 080C 0001"):  # no watchdog, then own the outputs
            owner.sendall(bytes.fromhex("0001 0000 0006 01" + request))
            assert owner.recv(64)[7] == 6
        summary = run_coupler("127.0.0.1", coupler.port, numbers=[COUPLER_CONTROL, 651], outputs=True)
        assert (ended(summary), summary.results) == ("link.session_occupied", ())
        reading = run_coupler("127.0.0.1", coupler.port, numbers=[COUPLER_CONTROL, 651])
    assert outcomes(reading) == {COUPLER_CONTROL: PASS, 651: UNSUPPORTED}


# A coupler that was left expired.


def let_expire(port: int) -> None:
    """Arm the watchdog with 20 ms, write, go, and wait until it has expired."""
    with socket.create_connection(("127.0.0.1", port), timeout=2.0) as master:
        for request in ("06 1120 0014", "06 080C 0001"):
            master.sendall(bytes.fromhex("0001 0000 0006 01" + request))
            assert master.recv(64)[7] == 6
        threading.Event().wait(0.06)
        master.sendall(bytes.fromhex("0001 0000 0006 01 03 0000 0001"))
        assert master.recv(64)[7:9] == b"\x83\x04"


@pytest.mark.realtime
def test_a_coupler_left_expired_is_reset_where_that_is_allowed_and_else_refused() -> None:
    with ThreadedCoupler() as coupler:
        let_expire(coupler.port)
        reading = run_coupler("127.0.0.1", coupler.port)
        assert (ended(reading), reading.results) == ("link.watchdog_expired", ())
        again = run_coupler("127.0.0.1", coupler.port, numbers=[COUPLER_CONTROL], outputs=True)
    assert outcomes(again) == {COUPLER_CONTROL: PASS}


# What is asked twice.


class DropsItsFirstAnswer(ControllerUnderTest):
    """Answers all requests but the first."""

    dropped = 0

    def answered(self, acknowledgement):  # type: ignore[no-untyped-def]
        self.dropped += 1
        return [] if self.dropped == 1 else [acknowledgement]


def late_by(ms: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tester finds that it was so late."""
    monkeypatch.setattr("conformance.subjects.LatenessWatch.worst_ms", lambda *_: ms)


@simulated
def test_what_fails_once_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    late_by(EXCUSED_MS, monkeypatch)
    with DropsItsFirstAnswer() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=[CONTROL, 401])
    assert outcomes(summary) == {CONTROL: FAIL, 401: PASS}
    assert len(summary.results[0].attempts) == 1


@simulated
def test_what_fails_once_while_the_tester_is_late_is_flaky_and_counts_as_passed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    late_by(EXCUSED_MS + 1.0, monkeypatch)
    with DropsItsFirstAnswer() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=[CONTROL, 401])
    assert outcomes(summary) == {CONTROL: FLAKY, 401: PASS}
    assert summary.passed
    assert "no Acknowledgement" in summary.results[0].detail
    assert [each.outcome for each in summary.results[0].attempts] == [FAIL, PASS]
    write_records(summary, tmp_path)
    written = json.loads((tmp_path / "results.json").read_text())
    assert (written["verdict"], written["clauses"]["3.1"]["verdict"]) == ("pass", "flaky")
    suite = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert (suite.get("failures"), len(suite.findall("testcase/flakyFailure"))) == ("0", 1)
    first = (tmp_path / "transcripts" / f"{CONTROL}.first.txt").read_text()
    assert "Acknowledgement" not in first.split("\n\n", 1)[1]
    assert "Acknowledgement" in (tmp_path / "transcripts" / f"{CONTROL}.txt").read_text()


@simulated
def test_what_fails_twice_failed_and_is_not_asked_a_third_time(monkeypatch: pytest.MonkeyPatch) -> None:
    late_by(1000.0, monkeypatch)

    class NeverAnswers(ControllerUnderTest):
        """Has no answer to requests."""

        def answered(self, acknowledgement):  # type: ignore[no-untyped-def]
            return []

    with NeverAnswers() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=[CONTROL])
    assert outcomes(summary) == {CONTROL: FAIL}
    assert len(summary.results[0].attempts) == 2
    assert summary.ended is None


# Profiles.


class WithoutOptions(ControllerUnderTest):
    """Grants neither paths nor streams."""

    def make_server(self) -> ReferenceServer:
        return ReferenceServer(77, shipped_arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, capabilities=0)


class DropsSigned(ControllerUnderTest):
    """Does not know clause 11."""

    def incoming(self, data: bytes) -> bytes | None:
        return b"" if len(data) > 9 and data[9] & 1 else data  # dropped, and counted


class NotToBeEnabled(ControllerUnderTest):
    """Has a plant that is not ready."""

    def __init__(self) -> None:
        super().__init__()
        self.bench.status = 0


def asked(kind: type[ControllerUnderTest], claims: str | None, *numbers: int) -> dict[int, CaseOutcome]:
    """Outcomes against such a controller under a profile."""
    profile = None if claims is None else profile_from(claims)
    with kind() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=numbers, motion=True, profile=profile)
    return outcomes(summary)


@simulated
@pytest.mark.parametrize(
    ("kind", "number", "part"),
    [
        (WithoutOptions, PATH, "paths"),
        (WithoutOptions, STREAM, "streaming"),
        (DropsSigned, KEYLESS, "key-refusal"),
        (DropsSigned, KEYLESS, "authentication"),
        (NotToBeEnabled, MOVES, "motion"),
    ],
)
def test_what_is_claimed_and_missing_fails(kind: type[ControllerUnderTest], number: int, part: str) -> None:
    assert asked(kind, part, CONTROL, number) == {CONTROL: PASS, number: FAIL}
    assert asked(kind, "base", CONTROL, number) == {CONTROL: PASS, number: UNSUPPORTED}
    assert asked(kind, None, CONTROL, number) == {CONTROL: PASS, number: UNSUPPORTED}
    assert asked(ControllerUnderTest, part, CONTROL, number) == {CONTROL: PASS, number: PASS}
    assert asked(ControllerUnderTest, "base", CONTROL, number) == {CONTROL: PASS, number: UNSUPPORTED}


class Basic(WithoutOptions, DropsSigned):
    """Has no optional part but motion."""


@pytest.mark.slow("the suite runs over and over")
@simulated
@pytest.mark.parametrize("kind", [Basic, NotToBeEnabled])
def test_who_lacks_optional_parts_fails_no_case(kind: type[ControllerUnderTest]) -> None:
    with kind() as controller:
        summary = run_reference("127.0.0.1", controller.port, motion=True)
    bad = {r.case.number: r.detail for r in summary.results if r.outcome in (FAIL, FLAKY)}
    assert bad == {}
    lacking = [r for r in summary.results if r.outcome is UNSUPPORTED]
    assert lacking
    assert [r.case.number for r in lacking if not r.case.needs] == []


def test_a_profile_is_of_names_and_says_what_is_wrong() -> None:
    expected = {OptionalPart.PATHS, OptionalPart.AUTHENTICATION, OptionalPart.KEY_REFUSAL}
    assert profile_from("paths, authentication") == expected
    assert profile_from("base") == frozenset()
    with pytest.raises(ConfigurationError, match="--profile wings: no such part; there are paths") as unknown:
        profile_from("paths,wings")
    assert unknown.value.cause == "conformance.unknown_part"
