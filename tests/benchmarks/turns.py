"""Times of several pieces of work, each round in turn, so that a busy machine is busy for all."""

import time
from collections.abc import Callable


def least_in_turn(*works: Callable[[], object], rounds: int = 30) -> list[float]:
    """Processor time (s) of each in this thread, the least of ``rounds``; one round before is not counted.

    The threads that a linear algebra library keeps spin beside small matrices, and do nothing for them.
    """
    least = [float("inf")] * len(works)
    for counted in range(rounds + 1):
        for k, work in enumerate(works):
            began_s = time.thread_time()
            work()
            if counted:
                least[k] = min(least[k], time.thread_time() - began_s)
    return least
