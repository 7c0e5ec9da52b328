"""A process that records is killed at random moments: what is older than 0.6 s is there."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from foundation.recording.recovery import recover
from plant_emulator.shell.recording import read_truth

KILLS = 100
LOST_NS = 600_000_000


@pytest.mark.experiment
def test_a_kill_loses_less_than_600_ms(tmp_path: Path) -> None:
    generator = random.Random(5)
    worst_ns, recorded = 0, 0
    for number in range(KILLS):
        path = tmp_path / f"{number}.mcap"
        command = [sys.executable, "-m", "tests.foundation.recording.recorded_process", str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            try:
                put = [int(process.stdout.readline())]
                time.sleep(generator.uniform(0.0, 2.0))
            finally:
                killed_ns = time.monotonic_ns()
                os.kill(process.pid, signal.SIGKILL)
            put += [int(line) for line in process.stdout.read().splitlines()]
        recover(path, tmp_path / "whole.mcap")
        recording = read_truth(tmp_path / "whole.mcap")
        (tmp_path / "whole.mcap").unlink()
        assert recording.complete
        kept = [record.log_ns for record in recording.truths]
        assert kept == put[: len(kept)]
        lost = put[len(kept) :]
        lost_ns = killed_ns - lost[0] if lost else 0
        worst_ns, recorded = max(worst_ns, lost_ns), recorded + len(kept)
        assert lost_ns < LOST_NS, f"kill {number}: {1e-6 * lost_ns:.0f} ms lost"
    print(f"\n{KILLS} of {KILLS} kills: {recorded} truths kept, {1e-6 * worst_ns:.0f} ms lost at worst")
