"""How fast this machine is now: a fixed piece of work that benchmarks compare theirs with."""

import time

import cv2
import numpy as np

_ROUNDS = 15
_TEXT = "slew lift tilt wrist1 wrist2 wrist3 " * 40


def yardstick_ms() -> float:
    """Processor time of one thread for the work, the least of 15 rounds: about 10 ms where limits were set.

    Half of it is Python's, half numpy's and OpenCV's, as in the code that is measured.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return 1e3 * min(_round() for _ in range(_ROUNDS))
    finally:
        cv2.setNumThreads(threads)


def _round() -> float:
    picture = (np.arange(720 * 1280, dtype=np.uint32) * 2654435761 >> 24).astype(np.uint8).reshape(720, 1280)
    matrices = np.linspace(0.0, 1.0, 200 * 36).reshape(200, 6, 6) + np.eye(6)
    begin = time.thread_time()
    counts: dict[str, int] = {}
    for k in range(15):
        for word in _TEXT.split():
            counts[word] = counts.get(word, 0) + k * len(word) % 7
    words = [(name, number / 3.0) for name, number in counts.items()]
    sum(number * number for _, number in words * 300)
    cv2.GaussianBlur(picture, (7, 7), 1.5)
    for _ in range(3):
        matrices = matrices @ matrices.transpose(0, 2, 1)
        matrices /= np.abs(matrices).max()
    np.sort(picture[::4].ravel())
    return time.thread_time() - begin
