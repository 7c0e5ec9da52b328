"""The two kinds of peers under test: how to look at each, what a run withholds, how a case reaches it."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from conformance.master import Master
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.preflight import Findings, look_at_controller, look_at_coupler
from conformance.wire import NonceSource
from protocol.authentication import LinkKey


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

    def open(self, findings: Findings) -> Peer | Master:
        """A fresh tester's end for one case; raises OSError."""
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

    def open(self, findings: Findings) -> Peer:
        """A peer from a port of its own."""
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

    def open(self, findings: Findings) -> Master:
        """A connection of its own."""
        return Master(self.host, self.port, self.unit, outputs=self.outputs, left_expired=findings.expired)
