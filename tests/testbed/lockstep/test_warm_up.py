"""The warm-up leaves no process behind."""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest


@pytest.mark.slow("imports all that is compiled")
def test_workers_end_with_their_parent(tmp_path: Path) -> None:
    warming = [sys.executable, "-m", "testbed.lockstep.warm_up"]
    with subprocess.Popen(warming, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}) as started:
        while started.poll() is None and not any(tmp_path.rglob("*.nbi")):
            time.sleep(0.1)
        workers = [w for w in psutil.Process(started.pid).children() if "spawn_main" in str(w.cmdline())]
        started.terminate()
    assert len(workers) == min(3, os.cpu_count() or 1)
    _, alive = psutil.wait_procs(workers, timeout=10)
    assert not alive
