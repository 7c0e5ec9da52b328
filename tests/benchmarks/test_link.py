"""How fast the links are, and whether a flood changes that: real processes, real sockets, `make bench`."""

import asyncio
import io
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import uvloop
from numpy.typing import ArrayLike
from pyModbusTCP.client import ModbusClient

from controller.config import PlantLinkConfig
from controller.shell.plant_link import PlantLink
from foundation.event_log import EventLog
from plant_emulator.shell.coupler import Coupler
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import Pose
from protocol.process_image import (
    CONTROL_ENABLE,
    STATUS_SUPPLY_ON,
    STATUS_VALVES_ENABLED,
    SensorImage,
    ValveImage,
    encode_sensors,
    encode_valves,
)
from protocol.reference_messages import Command, ReferencePose
from tests.conformance.couplers import RELEASE_NS, ThreadedCoupler
from tests.controller.obedient_plant import START_DEG, counts
from tests.integration.flood import flooding
from tests.support.killed_controller import insist, trial_rig
from tests.support.live_client import LiveClient
from tests.support.paths import CONFIGS, ROOT

pytestmark = pytest.mark.bench
CYCLE_MS = 5.0
REFERENCES = 100
ROUNDS, EXCHANGES, WARM = 15, 300, 50
OURS, OUR_COUPLER, PEERS = 0, 1, 3  # rows of the table of exchanges
FLOOD_HZ, FLOOD_S = 50_000.0, 12.0


class StillPlant(ThreadedCoupler):
    """An arm that never moves: its controller's valve words then stand still, and a change has one cause."""

    def __init__(self) -> None:
        self.changed_ns = 0
        self._image = ValveImage(0, 0, (0.0,) * 6)
        self._cycle = 0
        super().__init__()

    def make(self) -> Coupler:
        """The coupler to serve."""
        return Coupler(self.sensors, self._arrived, RELEASE_NS, time.monotonic_ns)

    def sensors(self) -> list[int]:
        """The input image."""
        self._cycle += 1
        enabled = STATUS_VALVES_ENABLED if self._image.control & CONTROL_ENABLE else 0
        q = counts(tuple(np.radians(START_DEG).tolist()))
        image = SensorImage(
            self._cycle, self._image.controller_cycle, STATUS_SUPPLY_ON | enabled, q, ((60.0, 60.0),) * 6,
            190.0, 10.0, 40.0,
        )  # fmt: skip
        return encode_sensors(image)

    def _arrived(self, image: ValveImage) -> None:
        if image.valves != self._image.valves and self.changed_ns == 0:
            self.changed_ns = time.monotonic_ns()
        self._image = image


@contextmanager
def controller(plant_port: int) -> Iterator[LiveClient]:
    """A client connected to a controller of its own."""
    ports = [f"controller.plant_link.port={plant_port}", "controller.reference_link.port=0"]
    command = [sys.executable, "-m", "controller", "--config-dir", str(CONFIGS), "--set", *ports]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            with LiveClient("127.0.0.1", ready["reference_link"]["port"]) as client:
                client.connect()
                yield client
        finally:
            process.terminate()


def test_reference_received_to_first_changed_valve_word() -> None:
    rng, taken_ms, late_ms = np.random.default_rng(1), [], 0.0
    with StillPlant() as plant, controller(plant.port) as client:
        for _ in range(REFERENCES):
            insist(client, CommandCode.ENABLE)
            state = client.until(lambda s: s.group_state is GroupState.STANDBY, 5.0)
            client.pump(0.1 + 0.005 * rng.random())  # at any phase of the cycle
            x, y, z = state.X_BT_cmd.p_m
            goal = Pose((x, y + 0.3, z + 0.1), state.X_BT_cmd.q_wxyz)
            plant.changed_ns = 0
            sent_ns = time.monotonic_ns()
            assert client.ask(ReferencePose(0, goal, 0.0)).reason is Reason.ACCEPTED
            while plant.changed_ns == 0:
                client.pump(0.002)
            taken_ms.append((plant.changed_ns - sent_ns) / 1e6)
            late_ms = max(late_ms, state.lateness_p99_us / 1e3)
            client.ask(Command(0, CommandCode.DISABLE))
            client.until(lambda s: s.group_state is GroupState.DISABLED, 5.0)
    p50, p99 = np.percentile(np.array(taken_ms) / CYCLE_MS, [50, 99])
    print(
        f"\nreference sent to first changed valve word in the coupler, {len(taken_ms)} references, "
        f"cycle {CYCLE_MS:g} ms: p50 {p50:.2f} cycles, p99 {p99:.2f} cycles; "
        f"the controller's own lateness p99, worst second: {late_ms:.2f} ms"
    )
    assert p50 <= 1.0
    assert p99 <= 1.5 + late_ms / CYCLE_MS  # of a machine that is busy with something else


def spread(times_us: ArrayLike) -> str:
    """Percentiles, µs."""
    return "".join(f"{value:>9.0f}" for value in np.percentile(times_us, [50, 99, 99.9]))


def linked(port: int) -> list[float]:
    """Round trips (µs) of our plant link, in the loop that the controller has."""
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        return runner.run(_linked(port))


async def _linked(port: int) -> list[float]:
    config = PlantLinkConfig(host="127.0.0.1", port=port, unit_id=1, timeout_ms=500.0, reconnect_ms=50.0)
    link, times = PlantLink(config, EventLog("controller", io.StringIO())), []
    link.start()
    while link.connections == 0:  # noqa: ASYNC110 - the link has no event to wait for
        await asyncio.sleep(0.01)
    for cycle in range(EXCHANGES):
        words = encode_valves(ValveImage(cycle % 65536, 0, (0.0,) * 6))
        began_ns = time.monotonic_ns()
        assert await link.exchange(words) is not None
        times.append((time.monotonic_ns() - began_ns) / 1e3)
    await link.close()
    return times


def polled(port: int) -> list[float]:
    """Round trips (µs) of pyModbusTCP."""
    client, times = ModbusClient("127.0.0.1", port, timeout=2.0, auto_open=True), []
    for cycle in range(EXCHANGES):
        words = encode_valves(ValveImage(cycle % 65536, 0, (0.0,) * 6))
        began_ns = time.monotonic_ns()
        assert client.write_read_multiple_registers(0x800, words, 0, 40) is not None
        times.append((time.monotonic_ns() - began_ns) / 1e3)
    client.close()
    return times


@contextmanager
def serving(name: str) -> Iterator[int]:
    """The port of one of ``fieldbus_servers``."""
    command = [sys.executable, "-m", "tests.integration.fieldbus_servers", name]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield int(process.stdout.readline())
        finally:
            process.kill()


def test_an_exchange_of_function_code_23_beside_peers() -> None:
    """Rounds of all in turn, so that a busy machine is busy for all."""
    with (
        serving("coupler") as ours,
        serving("pymodbustcp") as theirs,
        serving("pymodbus") as other,
    ):
        pairs: list[tuple[str, str, Callable[[int], list[float]], int]] = [
            ("our link", "our coupler", linked, ours),
            ("pyModbusTCP", "our coupler", polled, ours),
            ("our link", "pyModbusTCP", linked, theirs),
            ("pyModbusTCP", "pyModbusTCP", polled, theirs),
            ("our link", "pymodbus", linked, other),
        ]
        rounds = [[run(port)[WARM:] for _, _, run, port in pairs] for _ in range(ROUNDS)]
    print(f"\nFC 23, 40 words read and 12 written, {ROUNDS * (EXCHANGES - WARM)} exchanges each, µs")
    print(f"{'client':<14}{'server':<14}      p50      p99    p99.9  of pyModbusTCP's with its own server")
    medians = np.median(rounds, axis=2)
    ratios = np.median(medians / medians[:, [PEERS]], axis=0)  # of each round's, as the machine is then
    for (client, server, _, _), taken, ratio in zip(pairs, zip(*rounds, strict=True), ratios, strict=True):
        print(f"{client:<14}{server:<14}{spread(np.concatenate(taken))}{ratio:>9.2f}")
    # pymodbus reads and writes word by word. Where all peers share a processor 1.7 and 1.3 were measured,
    # where pyModbusTCP's two ends get one each and ours share one 0.9 and 1.2: docs/decisions, 29.
    assert ratios[OURS] <= 2.0
    assert ratios[OUR_COUPLER] <= 1.5


@pytest.mark.timeout(300)
def test_a_flood_does_not_make_the_scan_late_and_stop_works(tmp_path: Path) -> None:
    windows, stops_ms = [], []
    patient = ["controller.reference_link.link_timeout_ms=2000"]  # of a client that this machine may starve
    with trial_rig(CONFIGS, patient, tmp_path) as (launch, rig):
        client = rig.client
        client.connect()
        client.pump(3.0)
        assert client.state is not None
        before_us = client.state.lateness_p99_us
        insist(client, CommandCode.ENABLE)
        with flooding(launch.settings.controller.reference_link.port, FLOOD_HZ, FLOOD_S):
            client.pump(1.5)
            until_s, side = time.monotonic() + FLOOD_S - 3.5, 1.0
            while time.monotonic() < until_s:
                client.until(lambda s: s.group_state is GroupState.STANDBY, 3.0)
                assert client.move_by((0.0, 0.3 * side, 0.0)).reason is Reason.ACCEPTED
                client.pump(0.6)
                asked_ns = time.monotonic_ns()
                assert client.command(CommandCode.STOP) is Reason.ACCEPTED
                stops_ms.append((time.monotonic_ns() - asked_ns) / 1e6)
                client.pump(0.4)
                windows.append(client.state.lateness_p99_us)
                side = -side
            dropped, overruns = client.state.references_dropped, client.state.overruns
        client.command(CommandCode.DISABLE)
    print(
        f"\nflood of {FLOOD_HZ:.0f} datagrams/s, cycle {CYCLE_MS:g} ms: p99 lateness of a second, before "
        f"{before_us} µs, in the flood median {np.median(windows):.0f} µs, worst {max(windows)} µs; "
        f"{dropped} dropped, {overruns} overruns; STOP accepted after p50 {np.median(stops_ms):.1f} ms, "
        f"worst {max(stops_ms):.1f} ms ({len(stops_ms)} stops)"
    )
    assert dropped > 1000
    assert max(stops_ms) < 500.0
    assert max(windows) <= 1e3 * CYCLE_MS
