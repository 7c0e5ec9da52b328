"""Durations counted in constant memory: percentiles to the microsecond, for lateness and round trips."""

from collections.abc import Sequence

import numpy as np

_BINS = 50_000  # one a microsecond; what is longer is counted in the last and known by its maximum


class DurationHistogram:
    """Counts of durations. ``count``: how many; ``max_ns``: the longest; ``sum_ns``: of them all."""

    def __init__(self) -> None:
        self.count = 0
        self.max_ns = 0
        self.sum_ns = 0
        self._counts = np.zeros(_BINS + 1, dtype=np.int64)

    def add(self, duration_ns: int) -> None:
        """Count one duration; negative ones count as zero."""
        self.count += 1
        self.max_ns = max(self.max_ns, duration_ns)
        self.sum_ns += max(duration_ns, 0)
        self._counts[min(max(duration_ns, 0) // 1000, _BINS)] += 1

    def clear(self) -> None:
        """Forget everything."""
        self.count = self.max_ns = self.sum_ns = 0
        self._counts[:] = 0

    def percentiles_us(self, *shares: float) -> tuple[int, ...]:
        """For each of ``shares`` (0…1) the duration in µs that this share does not exceed; 0 when empty."""
        if self.count == 0:
            return (0,) * len(shares)
        sums = np.cumsum(self._counts)
        found = np.searchsorted(sums, np.array(shares) * self.count)
        return tuple(self.max_ns // 1000 if index >= _BINS else int(index) + 1 for index in found)

    def counts_below_us(self, bounds_us: Sequence[int]) -> tuple[int, ...]:
        """How many durations lie below each of the rising ``bounds_us``, 50 ms at most; the last: how many
        there are. Another thread may ask while durations are added.
        """
        parts = np.add.reduceat(self._counts, [0, *bounds_us])
        return tuple(np.cumsum(parts).tolist())

    def as_dict(self, prefix: str) -> dict[str, int]:
        """Percentiles and maximum by name, in µs."""
        p50, p99, p999 = self.percentiles_us(0.5, 0.99, 0.999)
        return {
            f"{prefix}_p50_us": p50,
            f"{prefix}_p99_us": p99,
            f"{prefix}_p999_us": p999,
            f"{prefix}_max_us": self.max_ns // 1000,
        }


def percent_missed(served: int, missed: int) -> float:
    """The share of ``missed`` among all periods, in percent; 0 before the first."""
    return 100.0 * missed / (served + missed) if served else 0.0
