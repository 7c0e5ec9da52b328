"""Faults 35 and 36: the controller killed or suspended within a motion, three real processes, judged by the
plant's recording and registers.
"""

from typing import Any

import pytest

from tests.support.killed_controller import KILL, SUSPEND_LONG, run_trials
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    directory = tmp_path_factory.mktemp("kills")
    made = run_trials(CONFIGS, [], [KILL, SUSPEND_LONG, KILL], 7, directory)
    assert {row["limit_ms"] for row in made} == {130.0}
    assert all(row["opening_at_signal"] > 0.005 for row in made), "the arm must have been moving"
    return made


@pytest.mark.slow("three services start")
@pytest.mark.timeout(300)
def test_case_35_a_killed_controller_is_stopped_by_the_plants_watchdog(rows: list[dict[str, Any]]) -> None:
    killed = [row for row in rows if row["kind"] == KILL]
    assert [row["pass"] for row in killed] == [True, True], killed
    assert all(row["group"] == "DISABLED" for row in killed)


@pytest.mark.timeout(300)
def test_case_36_a_controller_suspended_for_5_s_does_not_resume(rows: list[dict[str, Any]]) -> None:
    (row,) = [row for row in rows if row["kind"] == SUSPEND_LONG]
    assert row["pass"], row
    assert row["group"] == "ERROR_STOP"
    assert row["fault"] in ("OVERRUN", "PLANT_WATCHDOG", "PLANT_LINK_LOST", "REFERENCE_LINK_LOST")
