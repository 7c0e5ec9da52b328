"""Requests on their way from the reference link to the scan, and what becomes of them when a session ends."""

from collections import deque

from protocol.reference_messages import Command, Request
from protocol.session_events import RequestReceived, ServerEvent, SessionClosed, StreamedPoseReceived

_REQUESTS_A_SCAN = 8


class Inbox:
    """Requests in order of arrival, handed over a few a scan."""

    def __init__(self) -> None:
        self._waiting: deque[Request] = deque()
        self._streamed: StreamedPoseReceived | None = None
        self._last_words: tuple[Request, ...] | None = None

    def put(self, events: list[ServerEvent]) -> None:
        """Take note of what the session told."""
        for event in events:
            if isinstance(event, RequestReceived):
                self._waiting.append(event.message)
            elif isinstance(event, StreamedPoseReceived):
                self._streamed = event  # the newest supersedes those that no scan has seen
            elif isinstance(event, SessionClosed):
                # Commands, a stop above all, are still obeyed; motion is not begun for a peer that has gone.
                self._last_words = tuple(r for r in self._waiting if isinstance(r, Command))
                self._waiting.clear()
                self._streamed = None

    def take_streamed(self) -> StreamedPoseReceived | None:
        """The newest streamed reference since the last call."""
        streamed, self._streamed = self._streamed, None
        return streamed

    def take(self, link_alive: bool) -> tuple[tuple[Request, ...], bool]:
        """Requests for the next scan, and whether the link counts as alive in it.

        A session that ended counts as a dead link for one scan even if another one has begun: what the old
        peer had set in motion is not the new one's.
        """
        if self._last_words is not None:
            words, self._last_words = self._last_words, None
            return words, False
        count = min(len(self._waiting), _REQUESTS_A_SCAN)
        return tuple(self._waiting.popleft() for _ in range(count)), link_alive
