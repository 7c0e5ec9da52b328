"""Where a campaign's time went is told so that one sees what to blame."""

import pytest

from testbed.campaigns.time_spent import CameBack, came_back, time_spent


def test_two_workers_that_never_wait_are_at_work_all_the_time() -> None:
    runs = [CameBack(at_s, 10.0, 10.0) for at_s in (18.0, 18.0, 28.0, 28.0)]
    spent = time_spent(2, runs)
    assert spent is not None
    began, then = spent.told().split(", then ")
    assert began == "28.0 s with 2 workers: 8.0 s until the first run began"
    assert then == "100 % at work, each on 1.00 of a core"


def test_an_odd_run_leaves_a_worker_without_one() -> None:
    spent = time_spent(2, [CameBack(at_s, 10.0, 10.0) for at_s in (18.0, 18.0, 28.0)])
    assert spent is not None
    assert (spent.start_s, spent.at_work) == (8.0, pytest.approx(0.75))


def test_a_machine_with_other_work_is_told_by_the_share_of_a_core() -> None:
    spent = time_spent(1, [CameBack(20.0, 20.0, 5.0)])
    assert spent is not None
    assert (spent.at_work, spent.cores) == (1.0, 0.25)
    assert "with 1 worker: 0.0 s until" in spent.told()


def test_what_died_or_took_no_time_says_nothing() -> None:
    assert came_back(3.0, {"failure": "campaign.worker_lost"}) is None
    assert came_back(3.0, {"run_s": 2, "cpu_s": 1}) == CameBack(3.0, 2.0, 1.0)
    assert time_spent(2, []) is None
    assert time_spent(2, [CameBack(0.2, 0.1, 0.1)]) is None
