"""Exactly once: a stateful test of the ledger against a record of every id ever executed."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from protocol.command_ledger import CommandLedger
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement


def accepted(command_id: int) -> Acknowledgement:
    return Acknowledgement(command_id, Reason.ACCEPTED, float(command_id), 0.0)


class Repetitions(RuleBasedStateMachine):
    """Any mixture of new, repeated, overtaken and altered requests, answered in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.ledger = CommandLedger()
        self.executed: list[int] = []
        self.payloads: dict[int, bytes] = {}
        self.answers: dict[int, Acknowledgement] = {}

    @rule(command_id=st.integers(1, 12), payload=st.sampled_from([b"a", b"a", b"a", b"b"]))
    def request(self, command_id: int, payload: bytes) -> None:
        verdict = self.ledger.admit(command_id, payload)
        if verdict.execute:
            assert verdict.answer is None
            self.executed.append(command_id)
            self.payloads[command_id] = payload
        elif command_id not in self.payloads:
            assert verdict.answer is not None
            assert verdict.answer.reason is Reason.OVERTAKEN
            assert max(self.executed) > command_id
        elif payload != self.payloads[command_id]:
            assert verdict.answer is not None
            assert verdict.answer.reason is Reason.REPEATED_COMMAND_ID
        else:
            assert verdict.answer == self.answers.get(command_id)

    @rule(pick=st.integers(0, 100))
    def answer(self, pick: int) -> None:
        waiting = [i for i in self.executed if i not in self.answers]
        if waiting:
            command_id = waiting[pick % len(waiting)]
            assert self.ledger.settle(accepted(command_id))
            self.answers[command_id] = accepted(command_id)

    @rule(command_id=st.integers(1, 12))
    def answer_twice_or_unasked(self, command_id: int) -> None:
        if command_id in self.answers or command_id not in self.executed:
            assert not self.ledger.settle(accepted(command_id))

    @invariant()
    def executed_once_and_in_rising_order(self) -> None:
        assert self.executed == sorted(set(self.executed))


TestRepetitions = Repetitions.TestCase
TestRepetitions.settings = settings(max_examples=150, stateful_step_count=40)


def test_an_answer_settles_a_request_once_and_none_that_nobody_made() -> None:
    ledger = CommandLedger()
    assert ledger.admit(3, b"a").execute
    assert [ledger.settle(accepted(number)) for number in (2, 3, 3)] == [False, True, False]
    assert ledger.admit(3, b"a").answer == accepted(3)
