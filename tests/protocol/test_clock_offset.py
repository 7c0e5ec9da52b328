"""The clock offset and its bound under delay, asymmetry, drift, steps and lies."""

from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.clock_offset import ClockOffset, HeartbeatTracker
from protocol.reference_messages import HeartbeatReply

US = 1000
MS = 1_000_000
S = 1_000_000_000


def echo(clock: ClockOffset, at_ns: int, offset_ns: int, up_ns: int, down_ns: int, busy_ns: int = 0) -> bool:
    received = at_ns + up_ns + offset_ns
    return clock.add(at_ns, received, received + busy_ns, at_ns + up_ns + busy_ns + down_ns)


def test_nothing_is_known_before_the_first_echo() -> None:
    assert ClockOffset().estimate(0) is None


@settings(max_examples=300)
@given(
    st.integers(-(10**15), 10**15),
    st.lists(st.tuples(st.integers(0, 20 * MS), st.integers(0, 20 * MS), st.integers(0, 5 * MS)), min_size=1),
)
def test_the_truth_is_within_the_bound_whatever_the_delays(
    offset_ns: int, delays: list[tuple[int, int, int]]
) -> None:
    clock = ClockOffset()
    for i, (up, down, busy) in enumerate(delays):
        at_ns = i * 50 * MS
        assert echo(clock, at_ns, offset_ns, up, down, busy)
        estimate = clock.estimate(at_ns + up + busy + down)
        assert estimate is not None
        assert abs(estimate.offset_ns - offset_ns) <= estimate.uncertainty_ns
        assert estimate.uncertainty_ns <= (up + down + 1) // 2
        assert estimate.round_trip_ns == up + down


def test_the_best_way_out_and_the_best_way_back_need_not_be_one_echo() -> None:
    clock = ClockOffset()
    echo(clock, 0, 7 * S, 100 * US, 9 * MS)
    echo(clock, 50 * MS, 7 * S, 9 * MS, 100 * US)
    estimate = clock.estimate(60 * MS)
    assert estimate is not None
    assert abs(estimate.offset_ns - 7 * S) < 10 * US
    assert estimate.uncertainty_ns < 110 * US


def test_one_lie_is_set_aside_and_a_step_is_followed_after_three() -> None:
    clock = ClockOffset()
    for i in range(10):
        echo(clock, i * 50 * MS, 0, MS, MS)
    assert not echo(clock, 10 * 50 * MS, 3600 * S, MS, MS)
    assert clock.outliers == 1
    assert echo(clock, 11 * 50 * MS, 0, MS, MS)
    taken = [echo(clock, (12 + i) * 50 * MS, -3600 * S, MS, MS) for i in range(3)]
    assert taken == [False, False, True]
    estimate = clock.estimate(15 * 50 * MS)
    assert estimate is not None
    assert abs(estimate.offset_ns + 3600 * S) <= estimate.uncertainty_ns < 2 * MS


def test_lies_that_disagree_with_one_another_are_never_followed() -> None:
    clock = ClockOffset()
    echo(clock, 0, 0, MS, MS)
    for i in range(1, 30):
        assert not echo(clock, i * 50 * MS, i * S, MS, MS)
    estimate = clock.estimate(S)
    assert estimate is not None
    assert abs(estimate.offset_ns) <= estimate.uncertainty_ns


def test_an_echo_that_came_back_before_it_left_is_refused() -> None:
    clock = ClockOffset()
    assert not clock.add(100, 50, 60, 90)
    assert not clock.add(100, 60, 50, 200)
    assert clock.estimate(200) is None


def test_each_heartbeat_is_answered_once_and_an_echo_apart_from_the_others_is_dropped() -> None:
    tracker = HeartbeatTracker(500 * MS, 0)
    causes = []
    for at_ns, offset_ns in ((0, 0), (0, 0), (10 * MS, 0), (20 * MS, 3600 * S)):
        if at_ns or not causes:
            tracker.sent(at_ns)
        received_ns = at_ns + MS + offset_ns
        dropped = tracker.returned(HeartbeatReply(at_ns, received_ns, received_ns), at_ns + 2 * MS)
        causes.append(dropped and dropped.cause)
    assert causes == [None, "clock.unexpected_echo", None, "clock.outlier"]
