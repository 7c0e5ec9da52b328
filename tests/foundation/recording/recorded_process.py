"""``python -m tests.foundation.recording.recorded_process FILE`` records a truth every 16 ms until it is
killed, and says on stdout when it put each.
"""

import os
import sys
import time
from pathlib import Path

from plant_emulator.shell.truth_recorder import TruthRecorder
from tests.plant_emulator.shell.test_recording import truth


def main(path: Path) -> None:
    """Record until killed."""
    truths = [truth(number) for number in range(20)]
    recorder = TruthRecorder(path, {})
    number = 0
    while True:
        now_ns = time.monotonic_ns()
        recorder.truth(truths[number % 20]._replace(time_ns=number), now_ns)
        os.write(sys.stdout.fileno(), f"{now_ns}\n".encode())
        number += 1
        time.sleep(0.016)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
