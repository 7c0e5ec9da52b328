"""Durations in constant memory: percentiles exact to a microsecond, the longest kept whatever its length."""

import pytest

from foundation.periods import DurationHistogram, percent_missed


def test_percentiles_are_exact_to_the_microsecond() -> None:
    histogram = DurationHistogram()
    for microseconds in range(1000):
        histogram.add(microseconds * 1000)
    assert histogram.percentiles_us(0.5, 0.99, 0.999) == (500, 990, 999)
    histogram.add(3_000_000_000)
    assert histogram.max_ns == 3_000_000_000
    assert histogram.percentiles_us(1.0) == (3_000_000,)
    assert histogram.as_dict("late")["late_max_us"] == 3_000_000


def test_an_empty_histogram_has_percentiles_of_zero() -> None:
    histogram = DurationHistogram()
    assert histogram.percentiles_us(0.5, 0.99) == (0, 0)
    assert histogram.as_dict("late")["late_p99_us"] == 0
    histogram.add(5_000)
    histogram.clear()
    assert histogram.as_dict("late") == DurationHistogram().as_dict("late")


def test_a_negative_duration_counts_as_zero() -> None:
    histogram = DurationHistogram()
    histogram.add(-7)
    assert (histogram.count, histogram.max_ns, histogram.percentiles_us(1.0)) == (1, 0, (1,))


def test_the_share_of_missed_periods_is_of_all_periods() -> None:
    assert percent_missed(1001, 3) == pytest.approx(100.0 * 3 / 1004)
    assert percent_missed(0, 0) == 0.0
