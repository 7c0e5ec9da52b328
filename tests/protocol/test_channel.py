"""Order and age of arrival, against a naive oracle that remembers everything."""

from hypothesis import given
from hypothesis import strategies as st

from protocol.channel import (
    MAX_GAP_DATAGRAMS,
    SEQUENCE_MODULUS,
    WINDOW_DATAGRAMS,
    Arrival,
    Channel,
    LinkStatistics,
    TransitAge,
)
from protocol.datagram import Header, decode
from protocol.reference_messages import Heartbeat

MS = 1_000_000


def oracle(start: int, arrivals: list[int]) -> tuple[list[Arrival], int]:
    """Verdicts and number of losses for unwrapped sequence numbers, by sets instead of bits."""
    newest, seen, verdicts = start, set(range(start - 2 * WINDOW_DATAGRAMS, start + 1)), []
    lost: set[int] = set()
    for number in arrivals:
        if number > newest + MAX_GAP_DATAGRAMS:
            verdicts.append(Arrival.JUMP)
        elif number > newest:
            lost |= set(range(newest + 1, number))
            newest = number
            seen.add(number)
            verdicts.append(Arrival.NEW)
        elif number <= newest - WINDOW_DATAGRAMS:
            verdicts.append(Arrival.OLD)
        elif number in seen:
            verdicts.append(Arrival.DUPLICATE)
        else:
            seen.add(number)
            lost.discard(number)
            verdicts.append(Arrival.LATE)
    return verdicts, len(lost)


def test_the_window_is_that_of_the_written_protocol() -> None:
    assert WINDOW_DATAGRAMS == 64  # clause 5.2


@given(
    st.sampled_from([0, 1, 1000, SEQUENCE_MODULUS - 1, SEQUENCE_MODULUS - 40, SEQUENCE_MODULUS // 2]),
    st.lists(
        st.one_of(st.integers(-3, 8), st.integers(-80, 80), st.sampled_from([65536, 65537])), max_size=60
    ),
)
def test_order_is_judged_as_by_one_who_remembers_everything(start: int, steps: list[int]) -> None:
    channel, tally = Channel(5, 0, 1), LinkStatistics()
    channel.hear(Header(5, start, 0), 0, None, tally)
    numbers, at = [], start
    for step in steps:
        numbers.append(at + step)
        at = max(at, at + step) if step <= MAX_GAP_DATAGRAMS else at
    expected, lost = oracle(start, numbers)
    verdicts = [channel.hear(Header(5, number % SEQUENCE_MODULUS, 0), 0, None, tally) for number in numbers]
    assert [v.cause if v else Arrival.NEW.value for v in verdicts] == [e.value for e in expected]
    assert tally.lost == lost
    assert tally.duplicated == expected.count(Arrival.DUPLICATE)
    assert tally.received == 1 + expected.count(Arrival.NEW)
    assert tally.dropped == len(expected) - expected.count(Arrival.NEW)


def test_the_longest_gap_is_remembered() -> None:
    channel, tally = Channel(5, 0, 1), LinkStatistics()
    for number in (10, 11, 15, 16, 18):
        channel.hear(Header(5, number, 0), 0, None, tally)
    assert (tally.lost, tally.longest_gap) == (4, 3)


def test_the_sender_numbers_wraps_and_echoes() -> None:
    channel = Channel(5, 0, SEQUENCE_MODULUS - 1)
    first = decode(channel.encoded(Heartbeat(1), 1)).header
    assert (first.sequence, first.flags, first.echo_sequence) == (SEQUENCE_MODULUS - 1, 0, 0)
    channel.hear(Header(5, 99, 0), 0, None, LinkStatistics())
    second = decode(channel.encoded(Heartbeat(1), 1)).header
    assert (second.sequence, second.flags, second.echo_sequence) == (0, 1, 99)


@given(st.integers(0, 2**63), st.lists(st.integers(0, 400 * MS), min_size=1, max_size=50))
def test_age_is_the_delay_beyond_the_least_whatever_the_offset(sender_ns: int, delays: list[int]) -> None:
    age, least = TransitAge(), None
    for i, delay in enumerate(delays):
        least = delay if least is None else min(least, delay)
        sent_ns = i * 100 * MS
        assert age.age_ns(sender_ns + sent_ns, sent_ns + delay) == delay - least


def test_a_stale_datagram_is_counted_and_does_not_make_the_peer_seem_alive() -> None:
    channel, tally = Channel(5, 0, 1), LinkStatistics()
    channel.hear(Header(5, 1, 0), 0, 100 * MS, tally)
    dropped = channel.hear(Header(5, 2, 10 * MS), 500 * MS, 100 * MS, tally)
    assert dropped is not None
    assert dropped.cause == "datagram.stale"
    assert (tally.stale, channel.heard_ns) == (1, 0)
