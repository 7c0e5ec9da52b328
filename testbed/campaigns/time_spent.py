"""Where a campaign's time went: starting, running, waiting; and how much of a core its runs had.

A command that takes longer than its runs on N cores should is explained by one of the four: the start (once
a campaign), workers without a run (at the end some wait for the last one), cores that were busy with other
work, or runs that cost more processor time than they do alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

_SOON_S = 1.0  # nobody asks where less than that went


class CameBack(NamedTuple):
    """A run that came back: when, since the campaign began; how long it took, and its processor time."""

    at_s: float
    run_s: float
    cpu_s: float


class TimeSpent(NamedTuple):
    """Of the runs that were measured now, ``workers`` at once.

    ``wall_s`` passed in all, ``start_s`` of them until the first run began. From then on workers had a run
    for the share ``at_work``. A run had ``cores`` of a core: 1 when nothing else wanted it.
    """

    workers: int
    wall_s: float
    start_s: float
    at_work: float
    cores: float

    def told(self) -> str:
        """The same in words."""
        many = "1 worker" if self.workers == 1 else f"{self.workers} workers"
        return (
            f"{self.wall_s:.1f} s with {many}: {self.start_s:.1f} s until the first run began, then "
            f"{100 * self.at_work:.0f} % at work, each on {self.cores:.2f} of a core"
        )


def came_back(at_s: float, row: Mapping[str, Any]) -> CameBack | None:
    """The run of a row that came back ``at_s`` after the beginning; None where its worker died."""
    if row.get("run_s") is None or row.get("cpu_s") is None:
        return None
    return CameBack(at_s, float(row["run_s"]), float(row["cpu_s"]))


def time_spent(workers: int, runs: Sequence[CameBack]) -> TimeSpent | None:
    """Where the time went until the last of ``runs``; None where there was none to speak of."""
    running_s = sum(run.run_s for run in runs)
    if running_s < _SOON_S:
        return None
    wall_s = max(run.at_s for run in runs)
    start_s = max(0.0, min(run.at_s - run.run_s for run in runs))
    at_work = running_s / (workers * (wall_s - start_s))
    return TimeSpent(workers, wall_s, start_s, min(1.0, at_work), sum(run.cpu_s for run in runs) / running_s)
