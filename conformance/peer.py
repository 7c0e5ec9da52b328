"""The tester's end of the reference link."""

import time
from collections.abc import Callable, Iterator
from typing import Any

from conformance.wire import ANSWER_MS, Failed, NoAnswer, Unsupported, Wire, require
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    Command,
    HeartbeatReply,
    Hello,
    Request,
    State,
    Welcome,
)

HELLO_MS = 100
SESSION_MS = 6000
# A refusal outside a session is rationed to one in 50 ms: a second one is asked for no sooner.
RATION_MS = 60


class Peer(Wire):
    """A client of the controller under test, that can misbehave."""

    def second(self) -> "Peer":
        """Another peer from another port, sharing the transcript."""
        other = Peer(self.address[0], self.address[1], self._nonces, self.link_key)
        other._keys = self._keys
        other.transcript = self.transcript
        other._begin_ns = self._begin_ns
        self._others.append(other._socket)
        return other

    def open(
        self,
        *,
        capabilities: int = 1,
        arm_hash: int = 0,
        period_ms: int = 50,
        sequence: int | None = None,
        nonce: int | None = None,
        minor: int = 0,
    ) -> Welcome:
        """Opens a session, waiting while another one is still open. Raises Failed."""
        hello = Hello(nonce or self.nonce(), capabilities | self.required, arm_hash, period_ms)
        self.session = 0
        if sequence is not None:
            self.sequence = (sequence - 1) % self.sequences
        answer = self.greeted(hello, SESSION_MS, minor)
        if isinstance(answer, Welcome):
            self.alive("the first heartbeat")  # with it the session begins (4.2)
            return answer
        if answer is not None:
            _require_retry(answer)
        raise NoAnswer(f"no session within {SESSION_MS} ms")

    def reopen(self, **how: Any) -> Welcome:
        """Say BYE and open another session, as ``open``."""
        self.leave()
        return self.open(**how)

    def greeted(self, hello: Hello, wait_ms: int, minor: int = 0) -> Welcome | Reason | None:
        """What comes of ``hello``: its WELCOME, or the reason of BYE, or None when nothing comes.

        While another session is open it is sent again for ``wait_ms``; SESSION_OCCUPIED: it still is.
        """
        reason = None
        for _ in self.within(wait_ms):
            self.send(hello, session=0, minor=minor)
            datagram = self.receive(HELLO_MS, beating=False)
            if datagram is None or isinstance(datagram.message, State | HeartbeatReply):
                continue
            if isinstance(datagram.message, Welcome) and datagram.message.client_nonce == hello.client_nonce:
                self.session, self.minor = datagram.header.session, datagram.header.minor
                self.welcome = datagram.message
                self._heartbeat_ns = self.now_ns
                return datagram.message
            if isinstance(datagram.message, Bye):
                reason = datagram.message.reason
                if reason is not Reason.SESSION_OCCUPIED:
                    return reason
            time.sleep(HELLO_MS / 1e3)
        return reason

    def send_beside(self, source: Wire, data: Callable[[], bytes]) -> None:
        """Send ``data`` from ``source``; the number that it takes is taken again."""
        number = self.sequence
        source.send_raw(data())
        self.sequence = number

    def leave(self, reason: Reason = Reason.SHUTDOWN) -> None:
        """Says BYE and forgets the session."""
        self.send(Bye(reason))
        self.session = 0

    def alive(self, why: str) -> HeartbeatReply:
        """The reply to a heartbeat of now; raises Failed with ``why`` when there is none."""
        now_ns = self.heartbeat()
        what = f"{why}: the session is not alive"
        return self.expect(HeartbeatReply, what, beating=False, wanted=lambda r: r.sent_ns == now_ns)

    def ask(self, request: Request, why: str) -> Acknowledgement:
        """The acknowledgement of ``request``, sent once under its own id."""
        self.send(request)
        return self.answer_to(request.command_id, why)

    def answer_to(self, command_id: int, why: str, wait_ms: float = ANSWER_MS) -> Acknowledgement:
        """The next acknowledgement of ``command_id``; raises Failed."""
        return self.expect(Acknowledgement, why, wait_ms, wanted=lambda a: a.command_id == command_id)

    def command(self, code: CommandCode) -> Reason:
        """The reason that answers a new command."""
        return self.ask(Command(self.new_id(), code), f"{code.name} is answered").reason

    def answers(self, why: str) -> list[Acknowledgement]:
        """All acknowledgements that come while the controller had time to decide; the session must live."""
        fence = self.collect(self.grace_ms)
        self.passed_over.clear()
        self.alive(why)
        fence += self.passed_over + self.collect(1.0)
        return [d.message for d in fence if isinstance(d.message, Acknowledgement)]

    def gather(
        self, kind: Any, count: int, wait_ms: float = ANSWER_MS, *, after_ms: float = 3.0,
        beating: bool = True,
    ) -> list[Any]:  # fmt: skip
        """The messages of ``kind`` until ``count`` have come, or for ``wait_ms``; and ``after_ms`` on."""
        got: list[Any] = []
        for _, message in self.arriving(wait_ms, beating=beating):
            got += [message] if isinstance(message, kind) else []
            if len(got) >= count:
                break
        behind = self.collect(after_ms, beating=beating)
        return got + [message for _, message in behind if isinstance(message, kind)]

    def state(self, why: str = "STATE is sent") -> State:
        """A STATE that was sent after now; raises Failed."""
        self.drain()
        self.expect(State, why, 1000)
        return self.expect(State, why, 1000)

    def until(self, wanted: Callable[[State], bool], wait_ms: float, why: str) -> State:
        """The first STATE that is ``wanted``. Raises Failed."""
        for state in self.states(wait_ms, why):
            if wanted(state):
                return state
        raise Failed(f"{why}: not within {wait_ms:g} ms; {state.group_state.name}, fault {state.fault.name}")

    def require_counted(
        self, before: State, what: str, *, lost: int | None = None, dropped: int | None = None
    ) -> State:
        """A STATE of now; Failed unless it counts so many more ``lost``, ``dropped`` (None: any number)."""
        now = self.state()
        for name, wanted in (("lost", lost), ("dropped", dropped)):
            more = getattr(now, f"references_{name}") - getattr(before, f"references_{name}")
            require(wanted in (None, more), f"{what}: {more} {name}, wanted {wanted}")
        return now

    def states(self, wait_ms: float, why: str = "STATE is sent") -> Iterator[State]:
        """STATEs of ``wait_ms``, each sent after the one before was used; at least one. Raises Failed."""
        for _ in self.within(max(wait_ms, 1.0)):
            yield self.state(why)


_OTHER_KEY = {
    Reason.NOT_AUTHENTICATED: "the controller demands authentication: --key",
    Reason.KEY_NOT_CONFIGURED: "the controller has no key: authentication is not offered",
}


def _require_retry(reason: Reason) -> None:
    """Return if HELLO is to be sent again; else raise Unsupported or Failed."""
    if reason in _OTHER_KEY:
        raise Unsupported(_OTHER_KEY[reason])
    if reason is not Reason.SESSION_OCCUPIED:
        raise Failed(f"HELLO was refused with {reason.name}")
