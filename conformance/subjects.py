"""Whom the suites ask: what is looked at before, how it is opened, and how late the tester itself is."""

import threading
import time
from collections.abc import Mapping
from typing import NamedTuple, Protocol, Self

from conformance.master import Master
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.wire import Failed, NoAnswer, NonceSource
from protocol.authentication import LinkKey
from protocol.errors import LinkLost
from protocol.faults import Reason
from protocol.reference_messages import CAPABILITY_PATHS, CAPABILITY_STREAMING, Hello, Welcome

PERIOD_S = 0.01


class LatenessFigures(NamedTuple):
    """Lateness of a loop of 10 ms beside the cases, in ms; all 0 before its first period."""

    samples: int
    p50_ms: float
    p99_ms: float
    max_ms: float


class LatenessWatch:
    """A thread that waits 10 ms again and again, and notes by how much more it was waiting."""

    def __init__(self) -> None:
        self._late_ms: list[float] = []
        self._began_s = time.monotonic()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def _watch(self) -> None:
        while True:
            self._began_s = time.monotonic()
            if self._ending.wait(PERIOD_S):
                return
            self._late_ms.append(self._late_now_ms())

    def _late_now_ms(self) -> float:
        return max(time.monotonic() - self._began_s - PERIOD_S, 0.0) * 1e3

    @property
    def samples(self) -> int:
        """How many periods have been noted."""
        return len(self._late_ms)

    def figures(self, since: int = 0) -> LatenessFigures:
        """What was noted from sample ``since`` on, with the period that is not over yet."""
        return figures_of([*self._late_ms[since:], self._late_now_ms()])


def figures_of(late_ms: list[float]) -> LatenessFigures:
    """Median, 99th percentile (nearest rank) and maximum."""
    if not late_ms:
        return LatenessFigures(0, 0.0, 0.0, 0.0)
    ranked = sorted(late_ms)
    count = len(ranked)
    p50, p99 = (ranked[-(-count * percent // 100) - 1] for percent in (50, 99))
    return LatenessFigures(count, round(p50, 3), round(p99, 3), round(ranked[-1], 3))


LOOK_MS = 3000
_PAUSE_S = 0.2
_OFFERED = {OptionalPart.PATHS: CAPABILITY_PATHS, OptionalPart.STREAMING: CAPABILITY_STREAMING}
_REFUSED = {
    Reason.SESSION_OCCUPIED: ("link.session_occupied", "another client holds the session: end it first"),
    Reason.NOT_AUTHENTICATED: ("link.not_authenticated", "the controller demands authentication: give --key"),
    Reason.KEY_NOT_CONFIGURED: ("link.key_not_configured", "the controller has no key: leave --key out"),
    Reason.UNKNOWN_KEY: ("link.unknown_key", "the controller has another key than that of --key"),
}


class Findings(NamedTuple):
    """What a look has shown: the parts that are ``lacking``, each with the reason.

    ``expired``: the coupler's watchdog has, and this run may not reset it.
    """

    lacking: dict[OptionalPart, str]
    expired: bool = False


NOTHING_FOUND = Findings({})


def look_at_controller(peer: Peer) -> Findings:
    """Opens a session, leaves it again, and tells which capabilities were not granted.

    Raises LinkLost when nobody listens or answers, another client holds the session, or the keys do not fit.
    An answer that is wrong in any other way is left to the cases to judge.
    """
    where = f"{peer.address[0]}:{peer.address[1]}"
    offered = sum(_OFFERED.values()) | peer.required
    try:
        answer = peer.greeted(Hello(peer.nonce(), offered, 0, 100), LOOK_MS)
        if isinstance(answer, Welcome):
            peer.alive("the first heartbeat")
    except (NoAnswer, ConnectionRefusedError) as error:
        if peer.welcome is not None:
            return NOTHING_FOUND
        raise LinkLost("link.unreachable", f"{where}: nobody listens on this UDP port") from error
    except Failed:
        return NOTHING_FOUND
    except OSError as error:
        raise LinkLost("link.unreachable", f"{where}: {error.strerror or error}") from error
    finally:
        peer.close()
    if answer is None:
        hint = " (one that does not know clause 11 drops what is signed)" if peer.link_key else ""
        raise LinkLost("link.no_answer", f"{where}: HELLO is not answered within {LOOK_MS} ms{hint}")
    if isinstance(answer, Welcome):
        granted = answer.capabilities
        return Findings(
            {part: f"{part.name} is not granted" for part, bit in _OFFERED.items() if not granted & bit}
        )
    if answer in _REFUSED:
        cause, why = _REFUSED[answer]
        raise LinkLost(cause, f"{where}: {why}")
    return NOTHING_FOUND


def look_at_coupler(host: str, port: int, unit: int, *, outputs: bool) -> Findings:
    """Reads the status, and with ``outputs`` resets a watchdog that was left expired.

    Raises LinkLost when nobody accepts the connection or answers, or, with ``outputs``, when another master
    owns them. A wrong answer is left to the cases to judge.
    """
    where = f"{host}:{port}"
    try:
        master = Master(host, port, unit, outputs=outputs)
    except OSError as error:
        raise LinkLost("link.unreachable", f"{where}: no connection: {error.strerror or error}") from error
    try:
        if outputs:
            _free(master, where)
            if master.expired:
                master.reset()
            return NOTHING_FOUND
        return Findings({}, master.expired)
    except NoAnswer as error:
        raise LinkLost("link.no_answer", f"{where}: connected, but {error}") from error
    except OSError as error:
        raise LinkLost("link.unreachable", f"{where}: {error.strerror or error}") from error
    except Failed:
        return NOTHING_FOUND
    finally:
        master.hang_up()


def _free(master: Master, where: str) -> None:
    """Returns once nobody owns the outputs; raises LinkLost when somebody still does after LOOK_MS."""
    until_s = time.monotonic() + LOOK_MS / 1e3
    while master.owned_by_another():
        if time.monotonic() > until_s:
            why = "another master owns the outputs: stop it, or leave --outputs out"
            raise LinkLost("link.session_occupied", f"{where}: {why}")
        time.sleep(_PAUSE_S)


class Subject(Protocol):
    """A peer under test. ``withheld``: parts that this run may not ask for, each with the reason."""

    @property
    def suite(self) -> str:
        """The name of its suite."""
        ...

    @property
    def host(self) -> str:
        """Where it is."""
        ...

    @property
    def port(self) -> int:
        """Its port."""
        ...

    @property
    def withheld(self) -> Mapping[OptionalPart, str]:
        """Parts that this run may not ask for."""
        ...

    def look(self) -> Findings:
        """What a look at it shows; raises LinkLost."""
        ...

    def open(self, findings: Findings, number: int) -> Peer | Master:
        """A fresh tester's end for the case ``number``; raises OSError."""
        ...


class ControllerSubject(NamedTuple):
    """A controller on the reference link; ``motion``: its arm may be moved."""

    host: str
    port: int
    nonces: NonceSource
    key: LinkKey | None
    motion: bool
    suite: str = "reference link"

    @property
    def withheld(self) -> Mapping[OptionalPart, str]:
        """Parts that this run may not ask for."""
        withheld = {}
        if not self.motion:
            withheld[OptionalPart.MOTION] = "moves the arm: not allowed in this run"
        if self.key is None:
            withheld[OptionalPart.AUTHENTICATION] = "no key was given: --key"
        else:
            withheld[OptionalPart.KEY_REFUSAL] = "asked of controllers without a key"
        return withheld

    def look(self) -> Findings:
        """What a look at it shows; raises LinkLost."""
        return look_at_controller(self._peer())

    def open(self, findings: Findings, number: int) -> Peer:
        """A peer from a port of its own."""
        self.nonces.noted.case = number
        return self._peer()

    def _peer(self) -> Peer:
        return Peer(self.host, self.port, self.nonces, self.key)


class CouplerSubject(NamedTuple):
    """A bus coupler; ``outputs``: they may be written."""

    host: str
    port: int
    unit: int
    outputs: bool
    suite: str = "coupler"

    @property
    def withheld(self) -> Mapping[OptionalPart, str]:
        """Parts that this run may not ask for."""
        return {} if self.outputs else {OptionalPart.OUTPUTS: "writes outputs: not allowed in this run"}

    def look(self) -> Findings:
        """What a look at it shows; raises LinkLost."""
        return look_at_coupler(self.host, self.port, self.unit, outputs=self.outputs)

    def open(self, findings: Findings, number: int) -> Master:
        """A connection of its own."""
        return Master(self.host, self.port, self.unit, outputs=self.outputs, left_expired=findings.expired)
