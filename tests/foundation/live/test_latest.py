"""The queue between a quick writer and a slow reader: bounded, and the newest are in it."""

from foundation.live.wire import MOST_BYTES, MOST_MESSAGES, LatestQueue


def taken(queue: LatestQueue[int]) -> list[tuple[int, int]]:
    found = []
    while (item := queue.take()) is not None:
        found.append(item)
    return found


def test_what_is_read_in_time_comes_whole_and_in_order() -> None:
    queue: LatestQueue[int] = LatestQueue()
    for number in range(5):
        queue.put(number % 2, number, 10)
    assert taken(queue) == [(0, 0), (1, 1), (0, 2), (1, 3), (0, 4)]
    assert queue.dropped == 0
    assert queue.take() is None


def test_of_what_is_not_read_the_newest_of_each_topic_stay() -> None:
    queue: LatestQueue[int] = LatestQueue()
    queue.put(7, -1, 10)
    for number in range(1000):
        queue.put(1, number, 10)
    assert taken(queue) == [(7, -1), *((1, number) for number in range(1000 - MOST_MESSAGES, 1000))]
    assert queue.dropped == 1000 - MOST_MESSAGES


def test_of_pictures_one_alone_waits() -> None:
    queue: LatestQueue[int] = LatestQueue()
    for number in range(10):
        queue.put(1, number, MOST_BYTES)
    assert taken(queue) == [(1, 9)]
