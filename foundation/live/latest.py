"""A bounded queue by topic: where the reader is slow, the oldest of a topic make room for the newest."""

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")
# [D] A third of a second of the quickest topic; of pictures the newest alone.
MOST_MESSAGES, MOST_BYTES = 16, 1 << 20


class LatestQueue(Generic[T]):
    """Items by topic, taken from the topics in turn. ``dropped``: how many made room for newer ones.

    One thread may put while another takes.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: dict[int, deque[tuple[T, int]]] = {}
        self._turns: deque[int] = deque()

    def put(self, topic: int, item: T, size: int) -> None:
        """Keep ``item``, of ``size`` bytes, as the newest of ``topic``."""
        waiting = self._waiting.setdefault(topic, deque())
        waiting.append((item, size))
        bound = max(1, min(MOST_MESSAGES, MOST_BYTES // max(size, 1)))
        if len(waiting) <= bound:
            self._turns.append(topic)
            return
        while len(waiting) > bound:
            try:
                waiting.popleft()
            except IndexError:  # the taker was quicker
                break
            self.dropped += 1

    def take(self) -> tuple[int, T] | None:
        """Topic and item of the one whose turn it is; None when nothing waits."""
        while self._turns:
            topic = self._turns.popleft()
            try:
                return topic, self._waiting[topic].popleft()[0]
            except IndexError:  # dropped meanwhile
                continue
        return None
