"""Resident memory of processes."""

import subprocess
import sys

from foundation.self_watch import resident_mb


def test_resident_memory_of_this_process_of_another_and_of_one_that_has_gone() -> None:
    assert resident_mb() > 10.0
    command = [sys.executable, "-c", "print(flush=True); input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        assert 1.0 < resident_mb(other.pid) < 200.0
        other.communicate(b"end\n")
    assert resident_mb(other.pid) == 0.0
