"""Times of several pieces of work, each round in turn, so that a busy machine is busy for all."""

import time
from collections.abc import Callable


def least_in_turn(*works: Callable[[], object], rounds: int = 30) -> list[float]:
    """Processor time (s) of each, the least of ``rounds``; one round before is not counted."""
    least = [float("inf")] * len(works)
    for counted in range(rounds + 1):
        for k, work in enumerate(works):
            began_s = time.process_time()
            work()
            if counted:
                least[k] = min(least[k], time.process_time() - began_s)
    return least
