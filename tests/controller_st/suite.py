"""The compiled controller in the suite's simulated time, with the emulated plant beneath it in lockstep."""

import random
from functools import cache
from typing import Any, Self

from controller_st.program import TextController
from foundation.configuration import parse_overrides
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from protocol.process_image import decode_valves, encode_sensors
from testbed.scenarios.scenario import Settings, load_settings
from tests.conformance.simulated_network import SimulatedNetwork, SimulatedSocket
from tests.support.paths import CONFIGS

OVERRIDES = ("controller.reference_link.link_timeout_ms=200", "controller.supervision.overrun_ms=2000")


@cache
def settings(*overrides: str) -> Settings:
    return load_settings(CONFIGS, parse_overrides([*OVERRIDES, *overrides]))


class SimulatedTextController:
    """Takes its datagrams on arrival, or in its scan where ``in_scan``; the plant goes on with its scans."""

    def __init__(self, network: SimulatedNetwork, *, in_scan: bool = False, seed: int = 1) -> None:
        shipped = settings()
        drawn = random.Random(seed)
        self._network, self._in_scan = network, in_scan
        self._plant = Plant(shipped.plant, seed, Scene(shipped.scene).mounts)
        self.controller = TextController(
            shipped.arm, shipped.controller, 77, lambda: drawn.getrandbits(64) or 1
        )
        self._cycle_ns = round(1e6 * shipped.controller.cycle_ms)
        self._socket: Any = SimulatedSocket(network)
        self.port = self._socket.address[1]
        self.next_ns = network.now_ns
        self._waiting: list[tuple[bytes, int]] = []

    def __enter__(self) -> Self:
        self._network.controllers.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._network.controllers.remove(self)
        self._socket.close()

    def turn(self) -> None:
        """Read, scan if a scan is due, and send."""
        while self._socket.inbox and self._socket.readable():
            data, (_, port) = self._socket.recvfrom(65_536)
            self._waiting.append((data, port))
        due = self._network.clock_ns() >= self.next_ns
        if due or not self._in_scan:
            waiting, self._waiting = self._waiting, []
            self.controller.take(waiting, self._network.clock_ns())
        if due:
            self._scan()
            self.next_ns = max(self.next_ns + self._cycle_ns, self._network.now_ns)
        for data, port in self.controller.outgoing():
            self._socket.sendto(data, ("127.0.0.1", port))

    def _scan(self) -> None:
        self._plant.write(decode_valves(self.controller.valve_words))
        now_ns = self._network.clock_ns()
        words = encode_sensors(self._plant.read())
        self.controller.step(now_ns, now_ns, 1e-9 * self._cycle_ns, words)
        self._plant.advance(self._cycle_ns)
