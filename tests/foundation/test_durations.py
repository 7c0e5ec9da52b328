"""Durations in constant memory: percentiles exact to a microsecond, the longest kept whatever its length."""

from foundation.periods import DurationHistogram


def test_percentiles_are_exact_to_the_microsecond() -> None:
    histogram = DurationHistogram()
    for microseconds in range(1000):
        histogram.add(microseconds * 1000)
    assert histogram.percentiles_us(0.5, 0.99, 0.999) == (500, 990, 999)
    histogram.add(3_000_000_000)
    assert histogram.max_ns == 3_000_000_000
    assert histogram.percentiles_us(1.0) == (3_000_000,)
    assert histogram.as_dict("late")["late_max_us"] == 3_000_000
