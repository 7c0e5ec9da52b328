"""The plant's end of the fault API: one order after the other, each answered, and nothing that waits."""

import socket
from collections.abc import Iterator
from contextlib import closing
from typing import NamedTuple

import pytest

from plant_emulator.config.service import FaultApiConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.faults.kinds import SupplyLost
from plant_emulator.core.faults.schedule import (
    MOST_BYTES,
    FaultOrder,
    LookOrder,
    MendOrder,
    Order,
    OrderMessage,
    PlantAnswer,
    RestartOrder,
)
from plant_emulator.core.plant import Plant
from plant_emulator.shell.fault_desk import FaultDesk
from tests.plant_emulator.camera.camera_world import scene_config
from tests.plant_emulator.plant_world import plant_config
from tests.support.log_lines import HeardLog


class Bench(NamedTuple):
    """A plant, its desk, the API's end of the link, and the log."""

    plant: Plant
    desk: FaultDesk
    link: socket.socket
    log: HeardLog
    restarts: list[int]

    def order(self, number: int, order: Order) -> None:
        """What the API would send."""
        self.link.send(OrderMessage(number=number, order=order).model_dump_json().encode())

    def answer(self) -> PlantAnswer:
        """The answer to one order."""
        self.desk.serve()
        return PlantAnswer.model_validate_json(self.link.recv(MOST_BYTES))


@pytest.fixture
def bench() -> Iterator[Bench]:
    plant, log, restarts = Plant(plant_config(), seed=1), HeardLog("plant_emulator"), []
    config = FaultApiConfig(host="127.0.0.1", port=0, allowed=True)
    desk = FaultDesk(plant, Scene(scene_config()), config, log, lambda: restarts.append(plant.time_ns))
    desk._theirs.setblocking(False)
    with closing(desk._link), closing(desk._theirs):
        yield Bench(plant, desk, desk._theirs, log, restarts)


def test_one_order_at_a_time_however_many_wait(bench: Bench) -> None:
    for number in range(1, 6):
        bench.order(number, FaultOrder(fault=SupplyLost()) if number % 2 else MendOrder(number=None))
    for number in range(1, 6):
        assert bench.answer().number == number
        assert bool(bench.plant.faults.active) == bool(number % 2)
    assert len(bench.plant.faults.changes) == 5


def test_a_restart_is_answered_before_it_is_carried_out(bench: Bench) -> None:
    bench.order(1, MendOrder(number=None))
    assert bench.answer().number == 1
    assert bench.restarts == []
    bench.order(2, RestartOrder())
    assert bench.answer().cause == ""
    assert bench.restarts == [bench.plant.time_ns]


def test_an_api_that_takes_nothing_is_not_waited_for(bench: Bench) -> None:
    for number in range(5000):
        bench.order(number, LookOrder())
        bench.desk.serve()
    assert bench.link.recv(MOST_BYTES)


async def test_an_api_that_has_gone_is_told(bench: Bench) -> None:
    bench.link.close()
    bench.desk.serve()
    assert bench.log.text().count("link.fault_api_ended") == 1
