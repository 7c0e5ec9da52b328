"""Runs the cases against a controller or coupler at a host and port, and tells what came of each."""

import time
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import NamedTuple

from conformance.case import Attempt, CaseOutcome, ConformanceCase, Result, Summary, coupler, reference
from conformance.parts import OptionalPart, Profile
from conformance.records import COUPLER_STEPS, REFERENCE_STEPS, FirstHourStep
from conformance.subjects import NOTHING_FOUND, ControllerSubject, CouplerSubject, LatenessWatch, Subject
from conformance.wire import Failed, NonceSource, Unsupported
from protocol.authentication import LinkKey
from protocol.errors import LinkLost

# Loading a module enters its cases.
_MODULES = (
    "reference.framing", "reference.sessions", "reference.handshake", "reference.order",
    "reference.motion", "reference.endings", "reference.streaming", "reference.authentication",
    "reference.answers", "reference.datagrams_sent", "reference.datagram_refusals",
    "reference.datagram_drops", "reference.arm_transitions",
    "reference.arm_state_truth", "reference.arm_state_scan", "reference.arm_motion_times",
    "reference.arm_stream_times", "reference.arm_stream_following", "classes.long_numbers",
    "classes.real_numbers", "classes.bursts",
    "classes.many_peers",
)  # fmt: skip


class Manner(NamedTuple):
    """How the cases are asked. ``profile`` None: nothing is claimed, and everything asked for.

    ``first_hour``: in the order of ``conformance.records``, up to the first failure.
    """

    profile: Profile | None = None
    first_hour: bool = False


PLAIN = Manner()
# The slack of the tightest cases. A tester that was later than this may have failed by itself; one that was
# not has judged, and a second asking could only turn a fault that comes and goes into a pass.
EXCUSED_MS = 5.0


def reference_cases() -> tuple[ConformanceCase, ...]:
    """All cases for the reference link, by number."""
    for module in _MODULES:
        import_module(f"conformance.{module}")
    return reference.cases


def coupler_cases() -> tuple[ConformanceCase, ...]:
    """All cases for the coupler, by number."""
    import_module("conformance.coupler.sequences")
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
    host: str,
    port: int,
    *,
    numbers: Iterable[int] | None = None,
    motion: bool = False,
    seed: int = 0,
    key: LinkKey | None = None,
    manner: Manner = PLAIN,
    on_result: Callable[[Result], None] = lambda result: None,
) -> Summary:
    """Results of the reference link's cases against the controller at ``host``:``port``.

    ``numbers``: only these cases. ``motion``: also those that enable the group and move the arm by 20 mm;
    without it they count as unsupported. ``seed`` 0 draws nonces from the clock; a controller remembers the
    nonces of earlier runs, so another run needs another one. ``key``: every session is authenticated; without
    one the cases about authentication are unsupported. ``on_result`` is called after every case.
    """
    nonces = NonceSource(seed or time.time_ns())
    cases = chosen(reference_cases(), numbers, REFERENCE_STEPS if manner.first_hour else None)
    return _run_cases(ControllerSubject(host, port, nonces, key, motion), cases, manner, on_result)


def run_coupler(
    host: str,
    port: int,
    *,
    unit: int = 1,
    numbers: Iterable[int] | None = None,
    outputs: bool = False,
    manner: Manner = PLAIN,
    on_result: Callable[[Result], None] = lambda result: None,
) -> Summary:
    """Results of the coupler's cases against the Modbus TCP coupler at ``host``:``port``.

    ``numbers``: only these cases. ``outputs``: also those that write outputs and let the watchdog expire;
    without it they count as unsupported. ``on_result`` is called after every case.
    """
    cases = chosen(coupler_cases(), numbers, COUPLER_STEPS if manner.first_hour else None)
    return _run_cases(CouplerSubject(host, port, unit, outputs), cases, manner, on_result)


def _run_cases(
    subject: Subject, cases: tuple[ConformanceCase, ...], manner: Manner, on_result: Callable[[Result], None]
) -> Summary:
    results: list[Result] = []
    ended = None
    begin_s = time.monotonic()
    with LatenessWatch() as watch:
        asking = _Asking(subject, manner.profile, watch)
        try:
            asking.begin(patient=manner.first_hour)
            for case in cases:
                results.append(asking.result(case))
                on_result(results[-1])
                if results[-1].outcome is CaseOutcome.FAIL:
                    if manner.first_hour:
                        break
                    asking.still_there(case)
        except LinkLost as lost:
            ended = lost
    return Summary(
        subject.suite, subject.host, subject.port, tuple(results), time.monotonic() - begin_s,
        watch.figures(), manner.profile, ended,
    )  # fmt: skip


class _Asking:
    """One run: asks each case, once more if the tester was late; knows what is withheld, lacking, claimed."""

    def __init__(self, subject: Subject, profile: Profile | None, watch: LatenessWatch) -> None:
        self._subject = subject
        self._profile = profile
        self._watch = watch
        self._findings = NOTHING_FOUND

    def begin(self, *, patient: bool) -> None:
        """Looks at the peer; raises LinkLost, but not for mere silence when ``patient``."""
        try:
            self._findings = self._subject.look()
        except LinkLost as lost:
            if not patient or lost.cause != "link.no_answer":
                raise

    def still_there(self, case: ConformanceCase) -> None:
        """Looks again after ``case`` failed; raises LinkLost, naming it."""
        try:
            self._findings = self._subject.look()
        except LinkLost as lost:
            raise LinkLost(lost.cause, f"after case {case.number}: {lost}") from lost

    def result(self, case: ConformanceCase) -> Result:
        """What comes of ``case``."""
        why = self._reason_not_to_ask(case)
        if why is not None:
            return Result(case, *why)
        first = self._attempt(case)
        if first.outcome is not CaseOutcome.FAIL or first.late_ms <= EXCUSED_MS:
            return Result(case, first.outcome, first.detail, (first,))
        try:
            self._findings = self._subject.look()
        except LinkLost:  # still_there tells of it
            return Result(case, first.outcome, first.detail, (first,))
        again = self._attempt(case)
        both = (first, again)
        if again.outcome is not CaseOutcome.PASS:
            return Result(case, CaseOutcome.FAIL, first.detail, both)
        said = (
            f"the tester was {first.late_ms:.0f} ms late; passed when asked again; at first: {first.detail}"
        )
        return Result(case, CaseOutcome.FLAKY, said, both)

    def _reason_not_to_ask(self, case: ConformanceCase) -> tuple[CaseOutcome, str] | None:
        """Outcome and reason of a case that need not be asked, or None."""
        for part in sorted(case.needs, key=lambda part: part.value):
            if self._profile is not None and part not in self._profile.claims:
                return CaseOutcome.UNSUPPORTED, f"not claimed by the profile: {part.value}"
            if part in self._subject.withheld:
                return CaseOutcome.UNSUPPORTED, self._subject.withheld[part]
            if part in self._findings.lacking:
                return self._missing(part, self._findings.lacking[part])
        return None

    def _missing(self, part: OptionalPart | None, why: str) -> tuple[CaseOutcome, str]:
        if part is not None and self._profile is not None and part in self._profile.claims:
            return CaseOutcome.FAIL, f"claimed by the profile ({part.value}), but: {why}"
        return CaseOutcome.UNSUPPORTED, why

    def _attempt(self, case: ConformanceCase) -> Attempt:
        samples, begin_s = self._watch.samples, time.monotonic()
        outcome, detail = CaseOutcome.PASS, ""
        try:
            peer = self._subject.open(self._findings, case.number)
        except OSError as error:
            return Attempt(CaseOutcome.FAIL, f"no connection: {error.strerror or error}", 0.0, ())
        try:
            try:
                case.run(peer)
            finally:
                peer.close()
        except Unsupported as reason:
            outcome, detail = self._missing(reason.part, str(reason))
        except Failed as reason:
            outcome, detail = CaseOutcome.FAIL, str(reason)
        except OSError as error:
            outcome, detail = CaseOutcome.FAIL, f"the socket failed: {error.strerror or error}"
        seconds = time.monotonic() - begin_s
        return Attempt(outcome, detail, seconds, tuple(peer.transcript), self._watch.figures(samples).max_ms)
