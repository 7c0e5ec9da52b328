"""Runs the cases against a controller or coupler at a host and port, and tells what came of each."""

import time
from collections.abc import Callable, Iterable
from contextlib import closing
from typing import Any

from conformance.case import Attempt, CaseOutcome, ConformanceCase, Result, Summary, coupler, reference
from conformance.classes import bursts, long_numbers, many_peers, real_numbers
from conformance.coupler import table
from conformance.parts import OptionalPart, Profile
from conformance.records import COUPLER_STEPS, REFERENCE_STEPS, FirstHourStep
from conformance.reference import (
    answers,
    arm_motion_times,
    arm_state_scan,
    arm_state_truth,
    arm_stream_following,
    arm_stream_times,
    arm_transitions,
    authentication,
    datagram_drops,
    datagram_refusals,
    datagrams_sent,
    endings,
    framing,
    handshake,
    motion,
    order,
    sessions,
    streaming,
)
from conformance.subjects import ControllerSubject, CouplerSubject, Lacking, LatenessWatch, Subject
from conformance.wire import Failed, Line, NonceSource, Unsupported
from protocol.authentication import LinkKey
from protocol.errors import LinkLost

# Loading a module enters its cases.
_MODULES = (
    framing, sessions, handshake, order, motion, endings, streaming, authentication, answers, datagrams_sent,
    datagram_refusals, datagram_drops, arm_transitions, arm_state_truth, arm_state_scan, arm_motion_times,
    arm_stream_times, arm_stream_following, long_numbers, real_numbers, bursts, many_peers, table,
)  # fmt: skip


# The slack of the tightest cases. A tester that was later than this may have failed by itself; one that was
# not has judged, and a second asking could only turn a fault that comes and goes into a pass.
EXCUSED_MS = 5.0


def reference_cases() -> tuple[ConformanceCase, ...]:
    """All cases for the reference link, by number."""
    return reference.cases


def coupler_cases() -> tuple[ConformanceCase, ...]:
    """All cases for the coupler, by number."""
    return coupler.cases


def chosen(
    cases: tuple[ConformanceCase, ...],
    numbers: Iterable[int] | None,
    steps: tuple[FirstHourStep, ...] | None = None,
) -> tuple[ConformanceCase, ...]:
    """Those of ``cases`` with ``numbers`` (None: all), by number, or those of ``steps`` in their order."""
    expected = None if numbers is None else set(numbers)
    by_number = {case.number: case for case in cases if expected is None or case.number in expected}
    if steps is None:
        return tuple(by_number.values())
    return tuple(by_number[step.number] for step in steps if step.number in by_number)


def run_reference(
    host: str, port: int, *, motion: bool = False, seed: int = 0, key: LinkKey | None = None, **asking: Any
) -> Summary:
    """Results of the reference link's cases against the controller at ``host``:``port``.

    ``motion``: also those that enable the group and move the arm by 20 mm; without it they count as
    unsupported. ``seed`` 0 draws nonces from the clock; a controller remembers the nonces of earlier runs, so
    another run needs another one. ``key``: every session is authenticated; without one the cases about
    authentication are unsupported. ``asking``: as of ``run_suite``.
    """
    subject = ControllerSubject(host, port, NonceSource(seed or time.time_ns()), key, motion)
    return run_suite(subject, reference_cases(), REFERENCE_STEPS, **asking)


def run_coupler(host: str, port: int, *, unit: int = 1, outputs: bool = False, **asking: Any) -> Summary:
    """Results of the coupler's cases against the Modbus TCP coupler at ``host``:``port``.

    ``outputs``: also those that write outputs and let the watchdog expire; without it they count as
    unsupported. ``asking``: as of ``run_suite``.
    """
    return run_suite(CouplerSubject(host, port, unit, outputs), coupler_cases(), COUPLER_STEPS, **asking)


def run_suite(
    subject: Subject,
    cases: tuple[ConformanceCase, ...],
    steps: tuple[FirstHourStep, ...],
    *,
    numbers: Iterable[int] | None = None,
    profile: Profile | None = None,
    first_hour: bool = False,
    on_result: Callable[[Result], None] = lambda result: None,
) -> Summary:
    """What comes of ``cases``; ``on_result`` is called after every one.

    ``numbers``: only these. ``profile`` None: nothing is claimed, and everything asked for. ``first_hour``:
    in the order of ``steps``, up to the first failure.
    """
    results: list[Result] = []
    ended = None
    begin_s = time.monotonic()
    with LatenessWatch() as watch:
        asking = _Asking(subject, profile, watch)
        try:
            asking.look(patient=first_hour)
            for case in chosen(cases, numbers, steps if first_hour else None):
                results.append(asking.result(case))
                on_result(results[-1])
                if results[-1].outcome is CaseOutcome.FAIL:
                    if first_hour:
                        break
                    asking.look(after=case)
        except LinkLost as lost:
            ended = lost
    return Summary(
        subject.suite, subject.host, subject.port, tuple(results), time.monotonic() - begin_s,
        watch.worst_ms(), profile, ended,
    )  # fmt: skip


class _Asking:
    """One run: asks each case, once more if the tester was late; knows what is withheld, lacking, claimed."""

    def __init__(self, subject: Subject, profile: Profile | None, watch: LatenessWatch) -> None:
        self._subject, self._watch = subject, watch
        self._profile = profile
        self._lacking: Lacking = {}

    def look(self, *, patient: bool = False, after: ConformanceCase | None = None) -> None:
        """Look at the peer; raises LinkLost, naming the case, but not for mere silence when ``patient``."""
        try:
            self._lacking = self._subject.look()
        except LinkLost as lost:
            if after is not None:
                raise LinkLost(lost.cause, f"after case {after.number}: {lost}") from lost
            if not patient or lost.cause != "link.no_answer":
                raise

    def result(self, case: ConformanceCase) -> Result:
        """What comes of ``case``."""
        why = self._reason_not_to_ask(case)
        if why is not None:
            return Result(case, *why)
        first = self._attempt(case)
        once = Result(case, first.outcome, first.detail, (first,))
        if first.outcome is not CaseOutcome.FAIL or first.late_ms <= EXCUSED_MS:
            return once
        try:
            self.look()
        except LinkLost:  # the look after a failure tells of it
            return once
        again = self._attempt(case)
        if again.outcome is not CaseOutcome.PASS:
            return once._replace(attempts=(first, again))
        note = (
            f"the tester was {first.late_ms:.0f} ms late; passed when asked again; at first: {first.detail}"
        )
        return Result(case, CaseOutcome.FLAKY, note, (first, again))

    def _reason_not_to_ask(self, case: ConformanceCase) -> tuple[CaseOutcome, str] | None:
        """Outcome and reason of a case that need not be asked, or None."""
        for part in sorted(case.needs, key=lambda part: part.value):
            if self._profile is not None and part not in self._profile:
                return CaseOutcome.UNSUPPORTED, f"not claimed by the profile: {part.value}"
            if part in self._subject.withheld:
                return CaseOutcome.UNSUPPORTED, self._subject.withheld[part]
            if part in self._lacking:
                return self._missing(part, self._lacking[part])
        return None

    def _missing(self, part: OptionalPart | None, why: str) -> tuple[CaseOutcome, str]:
        if part is not None and self._profile is not None and part in self._profile:
            return CaseOutcome.FAIL, f"claimed by the profile ({part.value}), but: {why}"
        return CaseOutcome.UNSUPPORTED, why

    def _attempt(self, case: ConformanceCase) -> Attempt:
        periods, begin_s = len(self._watch.late_ms), time.monotonic()
        outcome, detail, transcript = CaseOutcome.PASS, "", list[Line]()
        try:
            with closing(self._subject.open(case)) as peer:
                transcript = peer.transcript
                case.run(peer)
        except Unsupported as reason:
            outcome, detail = self._missing(reason.part, str(reason))
        except Failed as reason:
            outcome, detail = CaseOutcome.FAIL, str(reason)
        except OSError as error:
            outcome, detail = CaseOutcome.FAIL, f"the connection failed: {error.strerror or error}"
        seconds = time.monotonic() - begin_s
        return Attempt(outcome, detail, seconds, tuple(transcript), self._watch.worst_ms(periods))
