"""Controllers that let a stop wait, each caught by the case meant for it."""

from collections import deque

from controller.core.inbox import Inbox
from protocol.axes_group import Mode
from protocol.datagram_layout import Kind
from protocol.faults import CommandCode
from protocol.reference_messages import Acknowledgement, Command, Request, is_stop, overtaken
from protocol.session_events import RequestReceived, ServerEvent, SessionClosed, StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant

KIND = 6


class _Queue(Inbox):
    """One queue for stops and others, from which a few are taken in a scan."""

    a_scan = 8
    most = 10**9

    def put(self, events: list[ServerEvent]) -> list[Acknowledgement]:
        refused: list[Acknowledgement] = []
        for event in events:
            if isinstance(event, RequestReceived):
                refused += self._queued(event.message)
            elif isinstance(event, SessionClosed | StreamedPoseReceived):
                super().put([event])
        return refused

    def _queued(self, request: Request) -> list[Acknowledgement]:
        self._waiting.append(request)
        gone, self._waiting = self._waiting[: -self.most], self._waiting[-self.most :]
        return [overtaken(each.command_id, request.command_id) for each in gone]

    def take(self, link_alive: bool) -> tuple[tuple[Request, ...], bool]:
        words, alive = super().take(link_alive) if self._last_words is not None else ((), link_alive)
        taken, self._waiting = self._waiting[: self.a_scan], self._waiting[self.a_scan :]
        return (*words, *taken), alive


class _Bounded(_Queue):
    a_scan = 1
    most = 64


class InOrderOfArrival(ControllerUnderTest):
    """Bounds its queue, and judges a stop when its turn has come, one request a scan."""

    def make_inbox(self) -> Inbox:
        return _Bounded()


class _StopsFirst(_Bounded):
    def _queued(self, request: Request) -> list[Acknowledgement]:
        if is_stop(request):
            self._waiting.insert(sum(map(is_stop, self._waiting)), request)
            return []
        return super()._queued(request)


class JudgesTheRestAfterwards(ControllerUnderTest):
    """Judges a stop at once, and then what came before it."""

    def make_inbox(self) -> Inbox:
        return _StopsFirst()


class _Endless(_Queue):
    def _queued(self, request: Request) -> list[Acknowledgement]:
        if not is_stop(request):
            return super()._queued(request)
        gone, self._waiting = self._waiting, [request]
        return [overtaken(each.command_id, request.command_id) for each in gone]


class QueuesWithoutBound(ControllerUnderTest):
    """Judges a stop at once, and lets everything else wait as long as it takes."""

    def make_inbox(self) -> Inbox:
        return _Endless()


class OneHeartbeatAScan(ControllerUnderTest):
    """Answers one heartbeat in a scan, and reads no further before it has."""

    def __init__(self) -> None:
        super().__init__()
        self._unread: deque[tuple[bytes, object]] = deque()
        self._beats = 1

    def _read(self) -> None:
        try:
            while True:
                self._unread.append(self._socket.recvfrom(65_535))
        except BlockingIOError:
            pass
        batch = []
        while self._unread:
            beats = self._unread[0][0][KIND : KIND + 1] == bytes([Kind.HEARTBEAT])
            if beats and not self._beats:
                break
            self._beats -= beats
            batch.append(self._unread.popleft())
        self._note(self.server.receive_batch(batch, self._clock_ns()))

    def _scan(self) -> None:
        self._beats = 1
        super()._scan()


class DeafWhileStopping(ControllerUnderTest):
    """Takes an emergency stop for a stop while it is stopping."""

    def judge(self, request: Request) -> Request:
        emergency = isinstance(request, Command) and request.code is CommandCode.EMERGENCY_STOP
        if emergency and self.bench.state.mode is Mode.STOPPING:
            return Command(request.command_id, CommandCode.STOP)
        return request


STOP_MUTANTS = (
    Mutant(InOrderOfArrival, 415),
    Mutant(JudgesTheRestAfterwards, 416),
    Mutant(QueuesWithoutBound, 417),
    Mutant(OneHeartbeatAScan, 418),
    Mutant(DeafWhileStopping, 533),
)
