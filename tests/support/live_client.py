"""A client of the reference link in real time, for trials: one socket, pumped by whoever waits."""

import select
import socket
import time
from collections.abc import Callable
from types import TracebackType

from protocol.client_session import ReferenceClient
from protocol.datagram_layout import MAX_DATAGRAM_BYTES
from protocol.errors import LinkLost
from protocol.faults import CommandCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import Acknowledgement, Command, ReferencePose, Request, State
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    ConnectionDelayed,
    SessionLost,
    StateReceived,
)

_TURN_S = 0.002


class LiveClient:
    """One session at a time; ``state`` is the newest that came, ``answers`` the acknowledgements by id.

    Nothing is sent or received but within ``pump`` and the methods that wait.
    """

    def __init__(self, host: str, port: int, state_period_ms: int = 10) -> None:
        self.state: State | None = None
        self.answers: dict[int, Acknowledgement] = {}
        self._open = False
        self._occupied = False
        self._session = ReferenceClient(time.monotonic_ns(), 0, state_period_ms)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((host, port))

    def __enter__(self) -> "LiveClient":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    @property
    def connected(self) -> bool:
        """Whether a session is open."""
        return self._session.connected

    def connect(self, timeout_s: float = 10.0) -> State:
        """The first state of a new session. Raises LinkLost when none comes in time, ``link.occupied`` when
        somebody else has the link."""
        deadline_s = time.monotonic() + timeout_s
        self.state = None
        while self.state is None:
            if not self._open:
                self._open = True
                self._session.connect(time.monotonic_ns())
            self._turn()
            if time.monotonic() > deadline_s:
                if self._occupied:
                    raise LinkLost("link.occupied", f"another client has had the link for {timeout_s:g} s")
                raise LinkLost("link.not_connected", f"no session within {timeout_s:g} s")
        return self.state

    def pump(self, seconds: float) -> None:
        """Keep the session alive for ``seconds``, or until it ends."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self._turn()

    def until(self, done: Callable[[State], bool], timeout_s: float) -> State:
        """The first state for which ``done`` holds. Raises LinkLost when none comes in time."""
        deadline_s = time.monotonic() + timeout_s
        while self.state is None or not done(self.state):
            if time.monotonic() > deadline_s or not self._session.connected:
                raise LinkLost("link.unanswered", f"not within {timeout_s:g} s: {self.state}")
            self._turn()
        return self.state

    def ask(self, request: Request, timeout_s: float = 5.0) -> Acknowledgement:
        """The answer to ``request``. Raises LinkLost when none comes in time."""
        command_id = self.submit(request)
        self.until(lambda _: command_id in self.answers, timeout_s)
        return self.answers[command_id]

    def submit(self, request: Request) -> int:
        """The id under which ``request`` is sent at the next turn. Raises LinkLost without a session."""
        return self._session.submit(request, time.monotonic_ns())

    def command(self, code: CommandCode) -> Reason:
        """The reason that answers a command."""
        return self.ask(Command(0, code)).reason

    def move_by(self, offset_m: tuple[float, float, float]) -> Acknowledgement:
        """The answer to a motion of the commanded pose by ``offset_m`` in B."""
        assert self.state is not None
        here = self.state.X_BT_cmd
        x, y, z = (p + d for p, d in zip(here.p_m, offset_m, strict=True))
        return self.ask(ReferencePose(0, Pose((x, y, z), here.q_wxyz), 0.0))

    def _turn(self) -> None:
        now_ns = time.monotonic_ns()
        self._take(self._session.tick(now_ns))
        for data in self._session.outgoing(now_ns):
            try:
                self._socket.send(data)
            except (BlockingIOError, ConnectionRefusedError):
                break
        select.select([self._socket], [], [], _TURN_S)
        while True:
            try:
                data = self._socket.recv(MAX_DATAGRAM_BYTES + 1)
            except (BlockingIOError, ConnectionRefusedError):
                return
            self._take(self._session.receive(data, time.monotonic_ns()))

    def _take(self, events: list[ClientEvent]) -> None:
        for event in events:
            if isinstance(event, AcknowledgementReceived):
                self.answers[event.acknowledgement.command_id] = event.acknowledgement
            elif isinstance(event, StateReceived):
                self.state = event.state
            elif isinstance(event, ConnectionDelayed):
                self._occupied = event.reason is Reason.SESSION_OCCUPIED
            elif isinstance(event, SessionLost):
                self._open = False
