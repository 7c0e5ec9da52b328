"""Whom the suites ask: what is looked at before, how it is opened, and how late the tester itself is."""

import threading
import time
from collections.abc import Mapping
from typing import NamedTuple, Self

from conformance.case import ConformanceCase
from conformance.master import Master
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.wire import NO_WELCOME, Failed, NoAnswer, NonceSource
from protocol.authentication import LinkKey
from protocol.errors import LinkLost
from protocol.faults import Reason
from protocol.reference_messages import CAPABILITY_PATHS, CAPABILITY_STREAMING, Hello, Welcome

PERIOD_S = 0.01


class LatenessWatch:
    """A thread that waits 10 ms again and again; ``late_ms``: by how much more it was waiting, each time."""

    def __init__(self) -> None:
        self.late_ms: list[float] = []
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
        while not self._ending.wait(PERIOD_S):
            self.late_ms.append(self._late_now_ms())
            self._began_s = time.monotonic()

    def _late_now_ms(self) -> float:
        return max(time.monotonic() - self._began_s - PERIOD_S, 0.0) * 1e3

    def worst_ms(self, since: int = 0) -> float:
        """The greatest lateness from period ``since`` on, with the one that is not over yet."""
        return round(max(*self.late_ms[since:], self._late_now_ms(), 0.0), 3)


LOOK_MS = 3000
_PAUSE_S = 0.2
_OFFERED = {OptionalPart.PATHS: CAPABILITY_PATHS, OptionalPart.STREAMING: CAPABILITY_STREAMING}
_REFUSED = {
    Reason.SESSION_OCCUPIED: ("link.session_occupied", "another client holds the session: end it first"),
    Reason.NOT_AUTHENTICATED: ("link.not_authenticated", "the controller demands authentication: give --key"),
    Reason.KEY_NOT_CONFIGURED: ("link.key_not_configured", "the controller has no key: leave --key out"),
    Reason.UNKNOWN_KEY: ("link.unknown_key", "the controller has another key than that of --key"),
}


Lacking = Mapping[OptionalPart, str]
"""The optional parts that a look has found lacking, each with the reason."""


def _free(master: Master, where: str) -> None:
    """Returns once nobody owns the outputs; raises LinkLost when somebody still does after LOOK_MS."""
    until_s = time.monotonic() + LOOK_MS / 1e3
    while master.owned_by_another():
        if time.monotonic() > until_s:
            why = "another master owns the outputs: stop it, or leave --outputs out"
            raise LinkLost("link.session_occupied", f"{where}: {why}")
        time.sleep(_PAUSE_S)


class ControllerSubject(NamedTuple):
    """A controller on the reference link; ``motion``: its arm may be moved."""

    host: str
    port: int
    nonces: NonceSource
    key: LinkKey | None
    motion: bool
    suite: str = "reference link"

    @property
    def withheld(self) -> Lacking:
        """Parts that this run may not ask for."""
        withheld = {} if self.motion else {OptionalPart.MOTION: "moves the arm: not allowed in this run"}
        if self.key is None:
            return withheld | {OptionalPart.AUTHENTICATION: "no key was given: --key"}
        return withheld | {OptionalPart.KEY_REFUSAL: "asked of controllers without a key"}

    def look(self) -> Lacking:
        """Open a session, leave it again, and tell which capabilities were not granted.

        Raises LinkLost when nobody listens or answers, another client holds the session, or the keys do not
        fit. An answer that is wrong in any other way is left to the cases to judge.
        """
        where, peer = f"{self.host}:{self.port}", self._peer()
        offered = sum(_OFFERED.values()) | peer.required
        try:
            answer = peer.greeted(Hello(peer.nonce(), offered, 0, 100), LOOK_MS)
            if isinstance(answer, Welcome):
                peer.alive("the first heartbeat")
        except (NoAnswer, ConnectionRefusedError) as error:
            if peer.welcome is not NO_WELCOME:
                return {}
            raise LinkLost("link.unreachable", f"{where}: nobody listens on this UDP port") from error
        except Failed:
            return {}
        except OSError as error:
            raise LinkLost("link.unreachable", f"{where}: {error.strerror or error}") from error
        finally:
            peer.close()
        if answer is None:
            hint = " (one that does not know clause 11 drops what is signed)" if self.key else ""
            raise LinkLost("link.no_answer", f"{where}: HELLO is not answered within {LOOK_MS} ms{hint}")
        if isinstance(answer, Reason):
            if answer in _REFUSED:
                cause, why = _REFUSED[answer]
                raise LinkLost(cause, f"{where}: {why}")
            return {}
        granted = answer.capabilities
        return {part: f"{part.name} is not granted" for part, bit in _OFFERED.items() if not granted & bit}

    def open(self, case: ConformanceCase) -> Peer:
        """A peer from a port of its own."""
        self.nonces.noted.case = case.number
        peer = self._peer()
        peer.moves = case.motion
        return peer

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
    def withheld(self) -> Lacking:
        """Parts that this run may not ask for."""
        return {} if self.outputs else {OptionalPart.OUTPUTS: "writes outputs: not allowed in this run"}

    def look(self) -> Lacking:
        """Read the status, and with ``outputs`` reset a watchdog that was left expired.

        Raises LinkLost when nobody accepts the connection or answers, with ``outputs`` when another master
        owns them, and without when its watchdog has expired. A wrong answer is left to the cases to judge.
        """
        where = f"{self.host}:{self.port}"
        try:
            master = self.open()
        except OSError as error:
            why = f"{where}: no connection: {error.strerror or error}"
            raise LinkLost("link.unreachable", why) from error
        try:
            if self.outputs:
                _free(master, where)
            if master.expired and not self.outputs:
                why = "its watchdog has expired, and a reset needs --outputs"
                raise LinkLost("link.watchdog_expired", f"{where}: {why}")
            if master.expired:
                master.reset()
        except NoAnswer as error:
            raise LinkLost("link.no_answer", f"{where}: connected, but {error}") from error
        except OSError as error:
            raise LinkLost("link.unreachable", f"{where}: {error.strerror or error}") from error
        except Failed:
            pass
        finally:
            master.hang_up()
        return {}

    def open(self, _case: ConformanceCase | None = None) -> Master:
        """A connection of its own."""
        return Master(self.host, self.port, self.unit, outputs=self.outputs)


Subject = ControllerSubject | CouplerSubject
