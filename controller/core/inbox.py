"""Requests on their way from the reference link to the scan, and what becomes of them when a session ends."""

from protocol.channel import is_newer
from protocol.reference_messages import Acknowledgement, Command, Request, is_stop, overtaken
from protocol.session_events import RequestReceived, ServerEvent, SessionClosed, StreamedPoseReceived

WAITING = 64  # [D]
_REQUESTS_A_SCAN = 8  # [D]


class Inbox:
    """Requests in order of arrival, handed over a few a scan; stops do not wait.

    A stop overtakes what waits: that is never judged, for what was asked for before a stop may not undo it
    afterwards. A reference overtakes the references that wait. At most ``WAITING`` requests wait; one more,
    and the oldest is overtaken.
    """

    def __init__(self) -> None:
        self._stops: list[Command] = []
        self._waiting: list[Request] = []
        self._streamed: StreamedPoseReceived | None = None
        self._last_words: list[Command] | None = None

    def put(self, events: list[ServerEvent]) -> list[Acknowledgement]:
        """The answers to requests that no scan will judge, once what the session told is noted."""
        refused: list[Acknowledgement] = []
        for event in events:
            if isinstance(event, RequestReceived):
                refused += self._enter(event.message)
            elif isinstance(event, StreamedPoseReceived):
                self._streamed = _newest(self._streamed, event)
            elif isinstance(event, SessionClosed):
                # A stop is still obeyed; nothing else is done for a peer that has gone.
                self._last_words = _without_repeats([*(self._last_words or ()), *self._stops])[0]
                self._stops, self._waiting, self._streamed = [], [], None
                refused.clear()
        return refused

    def take_streamed(self) -> StreamedPoseReceived | None:
        """The newest streamed reference since the last call."""
        streamed, self._streamed = self._streamed, None
        return streamed

    def take(self, link_alive: bool) -> tuple[tuple[Request, ...], bool]:
        """Requests for the next scan, stops first, and whether the link counts as alive in it.

        A session that ended counts as a dead link for one scan even if another one has begun: what the old
        peer had set in motion is not the new one's. The stops of both are for that scan.
        """
        stops, self._stops = self._stops, []
        if self._last_words is not None:
            words, self._last_words = self._last_words, None
            return (*words, *stops), False
        count = max(_REQUESTS_A_SCAN - len(stops), 0)
        others, self._waiting = self._waiting[:count], self._waiting[count:]
        return (*stops, *others), link_alive

    def _enter(self, request: Request) -> list[Acknowledgement]:
        """The answers to requests that ``request`` overtakes."""
        gone: list[Request] = []
        if is_stop(request):
            self._stops, repeated = _without_repeats([*self._stops, request])
            gone, self._waiting = [*repeated, *self._waiting], []
        else:
            commands = self._waiting
            if not isinstance(request, Command):
                commands = [each for each in self._waiting if isinstance(each, Command)]
                gone = [each for each in self._waiting if not isinstance(each, Command)]
            waiting = [*commands, request]
            gone, self._waiting = [*gone, *waiting[:-WAITING]], waiting[-WAITING:]
        return [overtaken(each.command_id, request.command_id) for each in gone]


def _newest(before: StreamedPoseReceived | None, event: StreamedPoseReceived) -> StreamedPoseReceived:
    """Which of two streamed references that no scan has seen supersedes the other."""
    if before is None or before.message.stream_id != event.message.stream_id:
        return event
    return event if is_newer(event.message.number, before.message.number) else before


def _without_repeats(stops: list[Command]) -> tuple[list[Command], list[Command]]:
    """``stops`` without the oldest of those that are said again later, as far as too many wait; and those."""
    kept, repeated = list(stops), []
    while len(kept) > WAITING:
        codes = [stop.code for stop in kept]
        repeated.append(kept.pop(next(i for i, code in enumerate(codes) if code in codes[i + 1 :])))
    return kept, repeated
