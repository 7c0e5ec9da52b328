"""What a second worker is worth, beside what a second bare process of the same runs is worth here."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from testbed.campaigns.campaign import CampaignRequest, run_campaign
from testbed.campaigns.time_spent import TimeSpent
from testbed.campaigns.workforce import SPAWN_ENVIRONMENT
from testbed.experiments.positioning.programs import one_run
from tests.support.paths import ROOT

RUNS = 8  # even, and all of one seed, so that no worker waits for the other at the end
KEPT = 0.95  # of what the machine has to give: cores share its memory
TASK = {"scenario": "standard", "seed": 9201, "looks": 2, "assignments": []}
RUN = (
    "import sys, time; from pathlib import Path; import cv2, numba\n"
    "cv2.setNumThreads(1); numba.set_num_threads(1)\n"
    "from testbed.experiments.positioning.programs import one_run\n"
    f"def run(): one_run(Path(sys.argv[1]), {TASK!r})\n"
    "run(); began = time.perf_counter(); run(); print(time.perf_counter() - began)"
)
pytestmark = [pytest.mark.bench, pytest.mark.timeout(3600)]


def slowest_s(at_once: int) -> float:
    """How long the slowest of so many bare processes takes for one run, its kernels compiled."""
    begun = [
        subprocess.Popen(
            [sys.executable, "-c", RUN, str(ROOT / "configs")],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {name: str(value) for name, value in SPAWN_ENVIRONMENT.items()},
        )
        for _ in range(at_once)
    ]
    return max(float(process.communicate()[0]) for process in begun)


def second_core() -> float:
    """How many times as much two bare processes do as one, the middle of three measurements."""
    return sorted(2.0 * slowest_s(1) / slowest_s(2) for _ in range(3))[1]


def campaign(directory: Path, workers: int) -> TimeSpent:
    request = CampaignRequest(ROOT / "configs", directory / str(workers), workers=workers, fresh=True)
    tasks = [{"key": f"run-{number}", **TASK} for number in range(RUNS)]
    done = run_campaign(request, partial(one_run, request.config_dir), tasks, f"{RUNS} runs")
    assert not [row["failure"] for row in done.rows if row["failure"]]
    assert done.spent is not None
    return done.spent


def test_a_second_worker_is_worth_what_a_second_process_is(tmp_path: Path) -> None:
    bare = second_core()
    one, two = campaign(tmp_path, 1), campaign(tmp_path, 2)
    whole = one.wall_s / two.wall_s
    running = (one.wall_s - one.start_s) / (two.wall_s - two.start_s)
    print(f"\n{one.told()}\n{two.told()}")
    print(
        f"two workers over one: {running:.2f} times once the runs have begun, {whole:.2f} with the start; "
        f"two bare processes of the same runs over one: {bare:.2f}"
    )
    if min(one.cores, two.cores) < 0.9:
        pytest.skip("other work has had the cores: nothing is said about workers")
    assert running >= KEPT * bare
