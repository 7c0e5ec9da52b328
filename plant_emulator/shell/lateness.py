"""How late a periodic task was: exact percentiles to a microsecond in constant memory."""

from typing import Any

import numpy as np

_BINS = 20_000  # microseconds; later than 20 ms is only counted and kept as the maximum


class Lateness:
    """Histogram of wake-up lateness, with the periods served and missed."""

    def __init__(self) -> None:
        self.served = 0
        self.missed = 0
        self.max_ns = 0
        self._counts = np.zeros(_BINS + 1, dtype=np.int64)

    def add(self, late_ns: int, missed: int) -> None:
        """One period served ``late_ns`` after its deadline, ``missed`` periods skipped before it."""
        self.served += 1
        self.missed += missed
        self.max_ns = max(self.max_ns, late_ns)
        self._counts[min(max(late_ns, 0) // 1000, _BINS)] += 1

    def percentile_us(self, share: float) -> float:
        """Lateness in µs that ``share`` (0…1) of the served periods do not exceed; 0 before the first."""
        if self.served == 0:
            return 0.0
        index = int(np.searchsorted(np.cumsum(self._counts), share * self.served))
        return self.max_ns / 1000.0 if index >= _BINS else float(index + 1)

    def as_dict(self) -> dict[str, Any]:
        """The figures by name, unit in the name."""
        total = self.served + self.missed
        return {
            "periods_served": self.served,
            "periods_missed": self.missed,
            "missed_percent": 100.0 * self.missed / total if total else 0.0,
            "late_p50_us": self.percentile_us(0.5),
            "late_p99_us": self.percentile_us(0.99),
            "late_p999_us": self.percentile_us(0.999),
            "late_max_us": self.max_ns / 1000.0,
        }
