"""The tester's end of the reference link."""

import time

from conformance.wire import ANSWER_MS, MS, Failed, NoAnswer, Unsupported, Wire
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
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
        if sequence is not None:
            self.sequence = (sequence - 1) % self.sequences
        answer = self.greeted(hello, SESSION_MS, minor)
        if isinstance(answer, Welcome):
            self.alive("the first heartbeat")  # with it the session begins (4.2)
            return answer
        if answer is not None:
            _require_retry(answer)
        raise NoAnswer(f"no session within {SESSION_MS} ms")

    def greeted(self, hello: Hello, wait_ms: int, minor: int = 0) -> Welcome | Reason | None:
        """What comes of ``hello``: its WELCOME, or the reason of BYE, or None when nothing comes.

        While another session is open it is sent again for ``wait_ms``; SESSION_OCCUPIED: it still is.
        """
        reason = None
        until_ns = self.now_ns + wait_ms * MS
        while self.now_ns < until_ns:
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

    def leave(self, reason: Reason = Reason.SHUTDOWN) -> None:
        """Says BYE and forgets the session."""
        self.send(Bye(reason))
        self.session = 0
        self.welcome = None

    def alive(self, why: str) -> HeartbeatReply:
        """The reply to a heartbeat of now; raises Failed with ``why`` when there is none."""
        now_ns = self.now_ns
        self.send(Heartbeat(now_ns), sent_ns=now_ns)
        until_ns = now_ns + ANSWER_MS * MS
        while (left_ns := until_ns - self.now_ns) > 0:
            reply = self.expect(
                HeartbeatReply, f"{why}: the session is not alive", left_ns / MS, beating=False
            )
            if reply.sent_ns == now_ns:
                return reply
        raise Failed(f"{why}: the session is not alive")

    def ask(self, request: Request, why: str) -> Acknowledgement:
        """The acknowledgement of ``request``, sent once under its own id."""
        self.send(request)
        return self.answer_to(request.command_id, why)

    def answer_to(self, command_id: int, why: str, wait_ms: float = ANSWER_MS) -> Acknowledgement:
        """The next acknowledgement of ``command_id``; raises Failed."""
        until_ns = self.now_ns + int(wait_ms * MS)
        while (left_ns := until_ns - self.now_ns) > 0:
            answer = self.expect(Acknowledgement, why, left_ns / MS)
            if answer.command_id == command_id:
                return answer
        raise Failed(f"{why}: no acknowledgement of {command_id}")

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

    def state(self, why: str = "STATE is sent") -> State:
        """A STATE that was sent after now; raises Failed."""
        self.drain()
        self.expect(State, why, 1000)
        return self.expect(State, why, 1000)


def _require_retry(reason: Reason) -> None:
    """Return if HELLO is to be sent again; else raise Unsupported or Failed."""
    if reason is Reason.NOT_AUTHENTICATED:
        raise Unsupported("the controller demands authentication: --key")
    if reason is Reason.KEY_NOT_CONFIGURED:
        raise Unsupported("the controller has no key: authentication is not offered")
    if reason is not Reason.SESSION_OCCUPIED:
        raise Failed(f"HELLO was refused with {reason.name}")
