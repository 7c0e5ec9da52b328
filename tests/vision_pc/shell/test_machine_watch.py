"""A machine that has begun anew is noticed; a camera that was plugged in, or a pause of the bus, is none."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from protocol.faults import Reason
from protocol.reference_messages import FLAG_PLANT_LINK_OK, State
from protocol.session_events import SessionLost, StateReceived
from tests.vision_pc.synthetic_station import bench
from vision_pc.application.console.overview import Overview
from vision_pc.core.types import StereoPair
from vision_pc.shell.link.udp_endpoint import MachineWatch

DARK = np.zeros((2, 2), np.uint8)


class Machine:
    """States and pictures in turn, 0.1 s apart; how often it was noticed that it has begun anew."""

    def __init__(self) -> None:
        self.newest: StereoPair | None = None
        self.now_ns = 0
        self.listeners: list[Any] = []
        self.noticed = 0
        link = cast(Any, self)
        MachineWatch(link, link, self.notice)

    def notice(self) -> None:
        self.noticed += 1

    def state(self, answers: bool = True) -> None:
        self.now_ns += 50_000_000
        told = cast(State, SimpleNamespace(flags=FLAG_PLANT_LINK_OK if answers else 0))
        for listener in self.listeners:
            listener(StateReceived(told))

    def picture(self, number: int) -> None:
        self.now_ns += 50_000_000
        self.newest = StereoPair(DARK, DARK, self.now_ns, number)

    def runs(self, first: int) -> None:
        for number in range(first, first + 5):
            self.picture(number)
            self.state()


def begun() -> Machine:
    machine = Machine()
    machine.state(answers=False)
    machine.state()
    machine.runs(100)
    return machine


@pytest.mark.parametrize("camera_first", [True, False])
def test_a_machine_that_was_restarted_is_noticed_once(camera_first: bool) -> None:
    machine = begun()
    machine.picture(105)  # the last one of the old row, before the bus is missed
    for _ in range(3):
        machine.state(answers=False)
    if camera_first:
        machine.picture(1)
        machine.state(answers=False)
    assert machine.noticed == 0
    machine.state()
    machine.runs(2)
    assert machine.noticed == 1
    machine.runs(10)
    assert machine.noticed == 1


def test_a_lost_session_counts_as_a_silent_plant() -> None:
    machine = begun()
    for listener in machine.listeners:
        listener(SessionLost(Reason.LINK_TIMEOUT, ()))
    machine.runs(1)
    assert machine.noticed == 1


def test_a_pause_of_the_bus_alone_or_a_new_camera_alone_is_no_restart() -> None:
    machine = begun()
    machine.state(answers=False)
    machine.picture(106)
    machine.runs(107)  # the camera has gone on
    machine.runs(1)  # and is started anew later on
    machine.state(answers=False)
    machine.runs(20)
    assert machine.noticed == 0


@pytest.mark.realtime
async def test_what_was_found_out_is_void_then() -> None:
    async with bench() as made:
        await made.post("/enable")
        await made.succeeded("look")
        made.station.track = made.station.calibration = cast(Any, object())
        answer = await made.post("/targets", {"u_px": 600.0, "v_px": 300.0})
        assert answer.status_code == 201, answer.text
        overview = Overview(made.station.links)
        overview.note(100.0, made.station)
        assert overview.anew_at is None
        made.station.begin_anew()
        overview.note(101.0, made.station)
        told = overview.document(made.station, None)
        assert told["anew_at"] == 101.0
        assert (told["tracked"], told["look"], told["calibration"]) == (False, None, None)
        assert [(row["cause"], row["began_at"]) for row in told["alarms"]] == [("machine.begun_anew", 101.0)]
        assert (await made.client.get("/targets")).json()["targets"][0]["known"] == "lost"
        refused = await made.post("/operations/look-then-move", {"method": "corrected"})
        assert (refused.status_code, refused.json()["cause"]) == (409, "refused.not_calibrated")
        assert made.events("machine_begun_anew")[0]["targets_lost"] == ["t1"]
