"""Runs the cases against a controller at a host and port, and tells what came of each."""

import time
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import NamedTuple

from testbed.conformance.case import Case, Outcome, reference
from testbed.conformance.peer import Peer
from testbed.conformance.wire import Failed, Line, NonceSource, Unsupported

# Loading a module enters its cases.
_MODULES = ("framing", "sessions", "lifetime", "order", "requests", "group", "motion")


class Result(NamedTuple):
    """What came of one case; ``detail`` says why it did not pass."""

    case: Case
    outcome: Outcome
    detail: str
    seconds: float
    transcript: tuple[Line, ...]


class Summary(NamedTuple):
    """Results in the order of the cases."""

    host: str
    port: int
    results: tuple[Result, ...]

    def count(self, outcome: Outcome) -> int:
        """How many cases ended so."""
        return sum(result.outcome is outcome for result in self.results)

    @property
    def passed(self) -> bool:
        """Whether something passed and nothing failed."""
        return self.count(Outcome.FAIL) == 0 and self.count(Outcome.PASS) > 0


def reference_cases() -> tuple[Case, ...]:
    """All cases for the reference link, by number."""
    for module in _MODULES:
        import_module(f"testbed.conformance.{module}")
    return reference.cases


def run_reference(
    host: str,
    port: int,
    *,
    numbers: Iterable[int] | None = None,
    motion: bool = False,
    seed: int = 0,
    on_result: Callable[[Result], None] = lambda result: None,
) -> Summary:
    """Results of the reference link's cases against the controller at ``host``:``port``.

    ``numbers``: only these cases. ``motion``: also those that enable the group and move the arm by 20 mm;
    without it they count as unsupported. ``seed`` 0 draws nonces from the clock; a controller remembers the
    nonces of earlier runs, so another run needs another one. ``on_result`` is called after every case.
    """
    wanted = None if numbers is None else set(numbers)
    nonces = NonceSource(seed or time.time_ns())
    results = []
    for case in reference_cases():
        if wanted is not None and case.number not in wanted:
            continue
        result = _run(case, host, port, nonces, motion)
        results.append(result)
        on_result(result)
    return Summary(host, port, tuple(results))


def _run(case: Case, host: str, port: int, nonces: NonceSource, motion: bool) -> Result:
    if case.motion and not motion:
        return Result(case, Outcome.UNSUPPORTED, "moves the arm: not allowed in this run", 0.0, ())
    peer = Peer(host, port, nonces)
    begin = time.monotonic()
    outcome, detail = Outcome.PASS, ""
    try:
        case.run(peer)
    except Unsupported as reason:
        outcome, detail = Outcome.UNSUPPORTED, str(reason)
    except Failed as reason:
        outcome, detail = Outcome.FAIL, str(reason)
    except OSError as error:
        outcome, detail = Outcome.FAIL, f"the socket failed: {error.strerror}"
    finally:
        peer.close()
    return Result(case, outcome, detail, time.monotonic() - begin, tuple(peer.transcript))
