"""The plant's end of the fault API: one order a step, every change told, and no step that waits."""

import itertools
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import NamedTuple

import pytest

from plant_emulator.config.service import FaultApiConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import true_points
from plant_emulator.core.faults.kinds import CouplerSilent, Fault, MarkerCovered, SupplyLost
from plant_emulator.core.faults.schedule import (
    MOST_BYTES,
    FaultOrder,
    MendOrder,
    Order,
    OrderAnswer,
    OrderMessage,
    PlantMessage,
    RestartOrder,
)
from plant_emulator.core.plant import Plant
from plant_emulator.shell.fault_desk import FaultDesk
from tests.plant_emulator.camera.camera_world import scene_config
from tests.plant_emulator.plant_world import plant_config
from tests.support.log_lines import HeardLog

MS = 1_000_000


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

    def told(self) -> list[PlantMessage]:
        """Everything that the desk has said."""
        messages = []
        while True:
            try:
                messages.append(PlantMessage.model_validate_json(self.link.recv(MOST_BYTES)))
            except BlockingIOError:
                return messages

    def answer(self) -> OrderAnswer:
        """The answer to one order, after one step."""
        self.desk.step()
        (message,) = self.told()
        assert message.answer is not None
        return message.answer


@pytest.fixture
def bench() -> Iterator[Bench]:
    with bench_of(shows_truth=False) as made:
        yield made


@contextmanager
def bench_of(shows_truth: bool) -> Iterator[Bench]:
    """A bench whose desk shows where the arm really is, or not."""
    plant, log, restarts = Plant(plant_config(), seed=1), HeardLog("plant_emulator"), []
    config = FaultApiConfig(host="127.0.0.1", port=0, allowed=True, shows_truth=shows_truth)
    desk = FaultDesk(plant, Scene(scene_config()), config, log, lambda: restarts.append(plant.time_ns))
    desk._theirs.setblocking(False)
    with closing(desk._link), closing(desk._theirs):
        yield Bench(plant, desk, desk._theirs, log, restarts)


def broken(fault: Fault) -> FaultOrder:
    """An order for ``fault``, at once."""
    return FaultOrder(fault=fault)


def test_one_order_a_step_however_many_wait(bench: Bench) -> None:
    for number in range(1, 6):
        bench.order(number, broken(SupplyLost()) if number % 2 else MendOrder(number=None))
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


def test_where_the_arm_is_is_told_with_the_state_where_that_is_asked_for(bench: Bench) -> None:
    bench.desk.step()
    (message,) = bench.told()
    assert message.arm_points_m is None
    with bench_of(shows_truth=True) as shown:
        shown.desk.step()
        (message,) = shown.told()
        assert message.arm_points_m == true_points(shown.plant)


def test_a_refused_order_is_answered_with_its_cause(bench: Bench) -> None:
    orders = {
        "refused.unknown_marker": broken(MarkerCovered(marker_id=17)),
        "refused.no_such_fault": MendOrder(number=9),
    }
    for cause, order in orders.items():
        bench.order(1, order)
        assert bench.answer().cause == cause
    assert not bench.plant.faults.changes


def test_every_change_is_told_at_once_and_the_time_now_and_then(bench: Bench) -> None:
    bench.desk.step()
    assert [message.state.active for message in bench.told()] == [[]]
    bench.plant.inject(CouplerSilent(), bench.plant.time_ns + 6 * MS, 8 * MS)
    told = []
    for _ in range(60):
        bench.plant.advance(2 * MS)
        bench.desk.step()
        told += [(message.state.time_ns // MS, len(message.state.active)) for message in bench.told()]
    assert told[:3] == [(2, 0), (6, 1), (14, 0)]  # planned, began, ended
    assert [later - before for (before, _), (later, _) in itertools.pairwise(told[2:])] == [50, 50]


def test_an_api_that_takes_nothing_holds_up_no_step(bench: Bench) -> None:
    for _ in range(5000):
        bench.plant.inject(SupplyLost())
        bench.desk.step()
        bench.plant.clear_faults()
        bench.desk.step()
    assert 0 < len(bench.told()) < 10_000


def test_an_api_that_has_gone_is_told_once(bench: Bench) -> None:
    bench.link.close()
    for _ in range(3):
        bench.desk.step()
    assert bench.log.text().count("link.fault_api_ended") == 1
