"""A demonstration that the machine stopped is repeated once."""

from pathlib import Path
from typing import Any

import pytest

from protocol.errors import LinkLost
from testbed.demonstration import runs
from testbed.reporting.run_directory import Choice
from testbed.scenarios.scenario import fault_orders

STOPPED, SLOW = LinkLost("link.camera_silent", "no pair for 2 s"), "the machine is overloaded: 40 % late"
CHOICE = Choice("standard", 1, 1)


@pytest.mark.parametrize(
    ("failure", "overload", "choice", "hold", "runs_made"),
    [
        (STOPPED, SLOW, CHOICE, False, 2),
        (STOPPED, "", CHOICE, False, 1),
        (None, SLOW, CHOICE, False, 1),
        (STOPPED, SLOW, CHOICE, True, 1),
        (STOPPED, SLOW, CHOICE._replace(faults=fault_orders(["valves_worn"])), False, 1),
    ],
    ids=["the machine", "the arm", "slow and whole", "watched", "broken on purpose"],
)
def test_what_the_machine_stopped_is_repeated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, failure: Any, overload: str, choice: Choice,
    hold: bool, runs_made: int,
) -> None:  # fmt: skip
    calls = []

    def run(*asked: Any) -> tuple[bool, runs.Driven]:
        calls.append(asked)
        return False, runs.Driven([], [], None, overload, failure)

    monkeypatch.setattr(runs, "_run", run)
    monkeypatch.setattr(runs, "end_on_sigterm", lambda: None)
    assert runs.run_demo(tmp_path, {}, choice, True, tmp_path, None, hold) is False
    assert len(calls) == runs_made
