"""Runs the cases against a controller or coupler at a host and port, and tells what came of each."""

import time
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import NamedTuple

from conformance.case import CaseOutcome, ConformanceCase, coupler, reference
from conformance.master import Master
from conformance.peer import Peer
from conformance.wire import Failed, Line, NonceSource, Unsupported
from protocol.authentication import LinkKey

# Loading a module enters its cases.
_COUPLER_MODULES = ("frames", "registers", "outputs", "watchdog")
_MODULES = (
    "framing", "sessions", "handshake", "lifetime", "order", "requests", "group", "motion", "endings",
    "stops", "streaming", "authentication",
)  # fmt: skip


class Result(NamedTuple):
    """What came of one case; ``detail`` says why it did not pass."""

    case: ConformanceCase
    outcome: CaseOutcome
    detail: str
    seconds: float
    transcript: tuple[Line, ...]


class Summary(NamedTuple):
    """Results in the order of the cases."""

    suite: str
    host: str
    port: int
    results: tuple[Result, ...]

    def count(self, outcome: CaseOutcome) -> int:
        """How many cases ended so."""
        return sum(result.outcome is outcome for result in self.results)

    @property
    def passed(self) -> bool:
        """Whether something passed and nothing failed."""
        return self.count(CaseOutcome.FAIL) == 0 and self.count(CaseOutcome.PASS) > 0


def reference_cases() -> tuple[ConformanceCase, ...]:
    """All cases for the reference link, by number."""
    for module in _MODULES:
        import_module(f"conformance.reference.{module}")
    return reference.cases


def run_reference(
    host: str,
    port: int,
    *,
    numbers: Iterable[int] | None = None,
    motion: bool = False,
    seed: int = 0,
    key: LinkKey | None = None,
    on_result: Callable[[Result], None] = lambda result: None,
) -> Summary:
    """Results of the reference link's cases against the controller at ``host``:``port``.

    ``numbers``: only these cases. ``motion``: also those that enable the group and move the arm by 20 mm;
    without it they count as unsupported. ``seed`` 0 draws nonces from the clock; a controller remembers the
    nonces of earlier runs, so another run needs another one. ``key``: every session is authenticated; without
    one the cases about authentication are unsupported. ``on_result`` is called after every case.
    """
    wanted = None if numbers is None else set(numbers)
    nonces = NonceSource(seed or time.time_ns())
    results = []
    for case in reference_cases():
        if wanted is not None and case.number not in wanted:
            continue
        result = _run(case, Peer(host, port, nonces, key), motion)
        results.append(result)
        on_result(result)
    return Summary("reference link", host, port, tuple(results))


def _run(case: ConformanceCase, peer: Peer, motion: bool) -> Result:
    if case.motion and not motion:
        peer.close()
        return Result(case, CaseOutcome.UNSUPPORTED, "moves the arm: not allowed in this run", 0.0, ())
    return _ask(case, peer)


def coupler_cases() -> tuple[ConformanceCase, ...]:
    """All cases for the coupler, by number."""
    for module in _COUPLER_MODULES:
        import_module(f"conformance.coupler.{module}")
    return coupler.cases


def run_coupler(
    host: str,
    port: int,
    *,
    unit: int = 1,
    numbers: Iterable[int] | None = None,
    outputs: bool = False,
    on_result: Callable[[Result], None] = lambda result: None,
) -> Summary:
    """Results of the coupler's cases against the Modbus TCP coupler at ``host``:``port``.

    ``numbers``: only these cases. ``outputs``: also those that write outputs and let the watchdog expire;
    without it they count as unsupported. ``on_result`` is called after every case.
    """
    wanted = None if numbers is None else set(numbers)
    results = []
    for case in coupler_cases():
        if wanted is not None and case.number not in wanted:
            continue
        result = _run_coupler(case, host, port, unit, outputs)
        results.append(result)
        on_result(result)
    return Summary("coupler", host, port, tuple(results))


def _run_coupler(case: ConformanceCase, host: str, port: int, unit: int, outputs: bool) -> Result:
    if case.motion and not outputs:
        return Result(case, CaseOutcome.UNSUPPORTED, "writes outputs: not allowed in this run", 0.0, ())
    try:
        master = Master(host, port, unit, outputs=outputs)
    except OSError as error:
        detail = f"no connection: {error.strerror or error}"
        return Result(case, CaseOutcome.FAIL, detail, 0.0, ())
    return _ask(case, master)


def _ask(case: ConformanceCase, peer: Peer | Master) -> Result:
    begin = time.monotonic()
    outcome, detail = CaseOutcome.PASS, ""
    try:
        try:
            case.run(peer)
        finally:
            peer.close()
    except Unsupported as reason:
        outcome, detail = CaseOutcome.UNSUPPORTED, str(reason)
    except Failed as reason:
        outcome, detail = CaseOutcome.FAIL, str(reason)
    except OSError as error:
        outcome, detail = CaseOutcome.FAIL, f"the socket failed: {error.strerror or error}"
    return Result(case, outcome, detail, time.monotonic() - begin, tuple(peer.transcript))
