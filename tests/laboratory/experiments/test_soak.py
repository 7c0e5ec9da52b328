"""The soak's account: growth, incidents and what explains them, faults, and a duty that goes on."""

import json
from pathlib import Path
from typing import Any, cast

import pytest
from pydantic import TypeAdapter

from laboratory.soak import duty as duty_module
from laboratory.soak.duty import Duty
from laboratory.soak.incidents import AFTERMATH_S, DISTURBANCES, OVERLOAD, Journal
from laboratory.soak.resources import (
    LONG_ENOUGH_MIN,
    Growth,
    ResourceSample,
    checks,
    growth,
)
from plant_emulator.core.faults.kinds import FAULTS, Fault
from protocol.errors import LinkLost, LongreachError
from testbed.realtime.rest_rig import JSON, RestRig
from testbed.reporting.console import Bar


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time of journal and duty, in a list of one."""
    now = [100.0]
    for module in ("incidents", "duty"):
        monkeypatch.setattr(f"laboratory.soak.{module}.time.monotonic", lambda: now[0], raising=True)
    return now


def test_growth_is_the_slope_after_the_warm_up() -> None:
    filling = [ResourceSample(10.0 * k, 100.0 + 5.0 * k, 10 + k) for k in range(10)]
    steady = [ResourceSample(100.0 + 36.0 * k, 150.0 + 0.02 * k, 20) for k in range(100)]
    found = growth(filling + steady, 100.0)
    assert found.mb_per_h == pytest.approx(2.0)
    assert found.error_mb_per_h == pytest.approx(0.0, abs=1e-9)
    assert (found.start_mb, found.end_mb) == (100.0, pytest.approx(151.98))
    assert (found.handles_from, found.handles_to) == (20.0, 20.0)


def test_a_fault_explains_what_happens_while_it_lasts_and_just_after(clock: list[float]) -> None:
    journal = Journal()
    journal.incident("look", "measurement.object_not_seen", "before")
    clock[0] += 0.1
    journal.fault("camera_blind", 2.0)
    journal.incident("look", "measurement.object_not_seen", "during")
    clock[0] += 2.0 + AFTERMATH_S
    journal.incident("look", "measurement.object_not_seen", "after")
    clock[0] += 0.1
    journal.incident("look", "measurement.object_not_seen", "long after")
    assert [i.explained_by for i in journal.incidents] == ["", "camera_blind", "camera_blind", ""]
    assert [i.detail for i in journal.unexplained] == ["before", "long after"]
    assert journal.counts()["look", "measurement.object_not_seen", "camera_blind"] == 2


@pytest.mark.parametrize("disturbance", DISTURBANCES, ids=lambda each: each.name)
def test_every_disturbance_is_a_fault_that_the_plant_takes(disturbance: Any) -> None:
    fault: Any = TypeAdapter(Fault).validate_python(disturbance.fault)
    assert type(fault) is FAULTS[disturbance.fault["kind"]]
    shortest, longest = disturbance.duration_s
    assert 0.0 < shortest < longest < 30.0


def test_overload_that_a_service_told_explains_what_came_just_before(
    clock: list[float], tmp_path: Path
) -> None:
    journal = Journal()
    clock[0] += 10.0
    journal.incident("poller", "link.link_timeout", "just before")
    clock[0] += 60.0
    journal.incident("poller", "link.link_timeout", "long after")
    log = tmp_path / "vision_pc.log"
    events = [
        {"event": name, "level": "warning", "time_ns": round(1e9 * at_s)}
        for name, at_s in (("overloaded", 113.0), ("overloaded", 143.0), ("overload_over", 150.0))
    ]
    log.write_text("\n".join(["no event", *map(json.dumps, events)]))
    journal.read_overloads([log])
    assert [i.explained_by for i in journal.incidents] == [OVERLOAD, ""]
    assert [tuple(each) for each in journal.overloads] == [(OVERLOAD, 8.0, 50.0)]


HOME = {"p_m": [3.9, 0.0, 1.0], "q_wxyz": [0.5, -0.5, 0.5, -0.5]}


class _Rig:
    """An arm whose second look fails and latches a fault, and which refuses the first RESET."""

    def __init__(self, clock: list[float]) -> None:
        self.clock = clock
        self.group = "disabled"
        self.commands: list[str] = []
        self.looks = 0
        self.at = HOME
        self.went: list[JSON] = []

    def state(self) -> JSON:
        return {"group_state": self.group, "X_BT": self.at}

    def command(self, name: str) -> None:
        self.commands.append(name)
        if self.commands.count("reset") == 1 and name == "reset":
            raise LinkLost("refused.plant_not_ready", "not yet")
        self.group = {"reset": "disabled", "enable": "standby"}[name]

    def operate(self, kind: str, body: JSON, bar: Bar) -> None:
        self.clock[0] += 5.0
        self.looks += kind == "look"
        if kind == "move":
            self.went.append(body["X_BT"])
            self.at = {**HOME, "p_m": [3.0, 1.0, 2.0]}  # a fault stopped it there
        if kind == "look" and self.looks == 2:
            self.group = "error_stop"
            raise LinkLost("link.camera_silent", "no picture")


def _duty(rig: _Rig, journal: Journal, alive: Any, monkeypatch: pytest.MonkeyPatch) -> Duty:
    def pass_time(seconds: float) -> None:
        rig.clock[0] += seconds

    monkeypatch.setattr(duty_module.time, "sleep", pass_time)
    return Duty(cast(RestRig, rig), journal, cast(Bar, None), alive)


def test_a_failed_look_is_noted_and_the_duty_goes_on(
    clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, journal = _Rig(clock), Journal()
    duty = _duty(rig, journal, lambda: None, monkeypatch)
    duty.keep(150.0, 70.0)
    assert rig.commands == ["enable", "reset", "reset", "enable"]
    assert [i.cause for i in journal.incidents] == ["link.camera_silent", "refused.plant_not_ready"]
    assert duty.done["look"] > 20
    assert (duty.done["move"], duty.done["trajectory-matching"]) == (2, 1)
    assert rig.went == [{**HOME, "p_m": [3.9, 0.15, 1.0]}, HOME]  # wherever it was stopped


def test_the_end_of_a_service_ends_the_duty(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> None:
        raise LongreachError("service.exited", "controller ended")

    duty = _duty(_Rig(clock), Journal(), gone, monkeypatch)
    with pytest.raises(LongreachError, match="controller ended"):
        duty.keep(150.0, 70.0)


def _figures(**changes: Any) -> dict[str, Any]:
    sound = Growth(100.0, 101.0, 0.2, 0.1, 20.0, 20.0)
    return {
        "minutes": LONG_ENOUGH_MIN,
        "ended_by": "",
        "controller": {"overruns_percent": 0.1},
        "unexplained": 0,
        "growth": {"vision_pc": sound},
    } | changes


def test_a_sound_soak_meets_every_limit() -> None:
    assert all(check.met for check in checks(_figures()))


@pytest.mark.parametrize(
    "changes",
    [
        {"ended_by": "controller ended"},
        {"controller": {"overruns_percent": 0.6}},
        {"unexplained": 1},
        {"growth": {"vision_pc": Growth(100.0, 110.0, 1.2, 0.1, 20.0, 20.0)}},
        {"growth": {"vision_pc": Growth(100.0, 101.0, 0.2, 0.1, 20.0, 21.0)}},
    ],
)
def test_what_breaks_a_limit_is_not_met(changes: dict[str, Any]) -> None:
    assert [check.met for check in checks(_figures(**changes))].count(False) == 1


def test_a_short_soak_does_not_judge_growth() -> None:
    grown = {"vision_pc": Growth(100.0, 110.0, 60.0, 0.1, 20.0, 25.0)}
    assert all(check.met is not False for check in checks(_figures(minutes=3.0, growth=grown)))
