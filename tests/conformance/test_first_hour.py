"""The first hour: a sound peer passes every step, a half-written one stops at the step of what it lacks."""

import pytest
from typer.testing import CliRunner

from conformance.case import CaseOutcome, Summary
from conformance.command import app
from conformance.first_hour import COUPLER_STEPS, REFERENCE_STEPS
from conformance.runner import Manner, run_coupler, run_reference
from protocol.datagram_layout import Kind
from protocol.reference_messages import Acknowledgement
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.couplers import ThreadedCoupler

simulated = pytest.mark.usefixtures("network")
FIRST_HOUR = Manner(first_hour=True)
OF_A_KEY = {701, 704, 718}


class HalfWritten(ControllerUnderTest):
    """Sends some kinds of datagrams only."""

    sends: tuple[Kind, ...] = ()

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        # Here, so that its datagrams stay numbered one by one.
        return [acknowledgement] if Kind.ACKNOWLEDGEMENT in self.sends else []

    def outgoing(self, data: bytes) -> list[bytes]:
        return [data] if data[6] in self.sends else []


def not_passed(summary: Summary) -> dict[int, str]:
    """What did not pass, and why."""
    return {
        r.case.number: f"{r.outcome.value} {r.detail}"
        for r in summary.results
        if r.outcome is not CaseOutcome.PASS
    }


@simulated
def test_a_sound_controller_passes_every_step_in_its_order() -> None:
    with ControllerUnderTest() as controller:
        summary = run_reference("127.0.0.1", controller.port, motion=True, manner=FIRST_HOUR)
    assert [result.case.number for result in summary.results] == [step.number for step in REFERENCE_STEPS]
    assert set(not_passed(summary)) == OF_A_KEY
    assert summary.passed


@pytest.mark.realtime
@pytest.mark.usefixtures("clock")
def test_a_sound_coupler_passes_every_step_in_its_order() -> None:
    with ThreadedCoupler() as coupler:
        summary = run_coupler("127.0.0.1", coupler.port, outputs=True, manner=FIRST_HOUR)
    assert [result.case.number for result in summary.results] == [step.number for step in COUPLER_STEPS]
    assert not_passed(summary) == {}


@simulated
@pytest.mark.parametrize(
    ("sends", "stops_at"),
    [
        ((), 200),
        ((Kind.WELCOME,), 317),
        ((Kind.WELCOME, Kind.HEARTBEAT_REPLY), 413),
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
        summary = run_reference("127.0.0.1", controller.port, motion=True, manner=FIRST_HOUR)
    assert summary.results[-1].case.number == stops_at
    assert summary.results[-1].outcome is CaseOutcome.FAIL
    assert summary.count(CaseOutcome.FAIL) == 1


@simulated
def test_the_command_shows_the_bytes_the_clause_and_what_to_write_next() -> None:
    with HalfWritten() as controller:
        controller.sends = (Kind.WELCOME,)
        done = CliRunner().invoke(app, ["reference", "--port", str(controller.port), "--first-hour"])
    assert done.exit_code == 1
    said = done.output
    assert "317 (clause 5.5) HEARTBEAT is answered at once" in said
    assert "→ 72 bytes, Hello sequence 1 session 0\n    client_nonce" in said
    assert f"Step 2 of {len(REFERENCE_STEPS)}. To write next: Answer HEARTBEAT at once" in said
