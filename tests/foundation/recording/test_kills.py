"""The recorder of each part in a process that is killed at any moment: what is older than 0.6 s is there."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from foundation.recording.decoding import messages
from foundation.recording.recovery import contents, recover
from tests.foundation.recording.recorded_process import PARTS

KILLS = 100
LOST_NS = 600_000_000
BEGINS_S = 60.0


@pytest.mark.experiment
@pytest.mark.parametrize("part", PARTS)
def test_a_kill_loses_less_than_600_ms(tmp_path: Path, part: str) -> None:
    generator = random.Random(5)
    worst_ns, recorded = 0, 0
    for number in range(KILLS):
        path = tmp_path / str(number) / f"{part}.mcap"
        path.parent.mkdir()
        put, killed_ns = killed_while_recording(part, path, generator.uniform(0.0, 2.0))
        recover(path, tmp_path / "whole.mcap")
        whole = contents(tmp_path / "whole.mcap")
        assert whole.complete
        assert not whole.damages
        kept = [record.log_time for _, record in messages(tmp_path / "whole.mcap", {PARTS[part].topic})]
        (tmp_path / "whole.mcap").unlink()
        path.unlink()
        assert kept == put[: len(kept)]
        lost = put[len(kept) :]
        lost_ns = killed_ns - lost[0] if lost else 0
        worst_ns, recorded = max(worst_ns, lost_ns), recorded + len(kept)
        pause_ns = max(np.diff(put[-100:]), default=0)
        told = f"the process itself paused for up to {1e-6 * pause_ns:.0f} ms before"
        assert lost_ns < LOST_NS, f"kill {number}: {1e-6 * lost_ns:.0f} ms lost; {told}"
    print(f"\n{part}: {KILLS} of {KILLS} kills: {recorded} of {PARTS[part].topic} kept,", end=" ")
    print(f"{1e-6 * worst_ns:.0f} ms lost at worst")


def killed_while_recording(part: str, path: Path, after_s: float) -> tuple[list[int], int]:
    """When each was put by a process that was killed ``after_s`` after its first, and when that was."""
    command = [sys.executable, "-m", "tests.foundation.recording.recorded_process", part, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            put = [int(process.stdout.readline())]
            time.sleep(after_s)
        finally:
            killed_ns = time.monotonic_ns()
            os.kill(process.pid, signal.SIGKILL)
        put += [int(line) for line in process.stdout.read().splitlines()]
    return put, killed_ns
