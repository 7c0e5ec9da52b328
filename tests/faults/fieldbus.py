"""The fieldbus cases' bench: real sockets between the controller's plant link, a proxy and the coupler.

Only time is not real: scans and physics are stepped, so that a busy machine changes nothing. An exchange
that ran into its timeout costs that timeout in simulated time as well; all others cost a cycle.
"""

import asyncio
import io
import math
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import pairwise

from controller.config import PlantLinkConfig
from controller.core.plant_watch import PlantRefusal
from controller.core.scan import scan
from controller.core.scan_types import ScanInput, ScanOutput, initial_state
from controller.core.settings import settings_from
from controller.shell.plant_link import PlantLink
from foundation.event_log import EventLog
from plant_emulator.core.plant import Plant
from protocol.errors import ImageRefused
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.process_image import decode_sensors, encode_valves
from protocol.reference_messages import Acknowledgement, Command, ReferencePose
from tests.faults.registers import Registers, assert_shut
from tests.faults.rig import CLOSING_NS, settings_of
from tests.support.fault_proxy import TcpProxy


class FieldbusRig:
    """Controller and plant; ``requests`` and ``answers`` are the two directions of the wire between them."""

    def __init__(self, registers: Registers, proxy: TcpProxy, timeout_ms: float) -> None:
        settings = settings_of(1, ())
        self.registers, self.proxy = registers, proxy
        self.requests, self.answers = proxy.requests, proxy.answers
        self.settings = settings_from(settings.arm, settings.controller)
        self.state = initial_state(self.settings)
        config = PlantLinkConfig(
            host="127.0.0.1", port=proxy.port, unit_id=1, timeout_ms=timeout_ms, reconnect_ms=20.0
        )
        self.link = PlantLink(config, EventLog("controller", io.StringIO()))
        self.outputs: list[ScanOutput] = []
        self.torn = 0
        self._cycle_ns = round(self.settings.cycle_s * 1e9)
        # As in the field the exchange costs its timeout, whatever this machine's pace demands.
        self._timeout_ns = math.ceil(40.0e6 / self._cycle_ns) * self._cycle_ns
        self._words = [0] * 12
        self._ids = 0

    @property
    def now_ns(self) -> int:
        """The simulated time."""
        return self.registers.plant.time_ns

    @property
    def view(self) -> ScanOutput:
        """The last scan's output."""
        return self.outputs[-1]

    async def step(self, *requests: Command | ReferencePose) -> ScanOutput:
        """One exchange and one scan."""
        timeouts = self.link.failures["timeout"]
        words = await self.link.exchange(self._words)
        dt_ns = self._cycle_ns
        if words is None and self.link.failures["timeout"] > timeouts:
            dt_ns = self._timeout_ns
            self.registers.advance(dt_ns - self._cycle_ns)
        elif words is None:
            await asyncio.sleep(1e-9 * self._cycle_ns)  # the connection is made in real time
        sensors = words if words is None or isinstance(words, PlantRefusal) else None
        if isinstance(words, list):
            try:
                sensors = decode_sensors(words)
            except ImageRefused:
                self.torn += 1
        inputs = ScanInput(self.now_ns, self.now_ns, 1e-9 * dt_ns, sensors, requests, True)
        self.state, output = scan(self.settings, self.state, inputs)
        self.outputs.append(output)
        self._words = encode_valves(output.valves)
        self.registers.advance(self._cycle_ns)
        return output

    async def run(self, seconds: float) -> None:
        """Let simulated time pass."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            await self.step()

    async def until(self, done: Callable[[], bool], limit_s: float = 8.0) -> float:
        """Simulated seconds until ``done``."""
        began_ns = self.now_ns
        while not done():
            assert self.now_ns - began_ns < limit_s * 1e9, "did not happen in time"
            await self.step()
        return 1e-9 * (self.now_ns - began_ns)

    async def command(self, code: CommandCode) -> Reason:
        """The answer to a command."""
        self._ids += 1
        return (await self.step(Command(self._ids, code))).acknowledgements[0].reason

    async def refer(self, y: float, z: float) -> Acknowledgement:
        """The answer to a motion by ``y`` and ``z`` (m, in B)."""
        self._ids += 1
        here = self.view.view.X_BT_cmd
        goal = Pose((here.p_m[0], here.p_m[1] + y, here.p_m[2] + z), here.q_wxyz)
        return (await self.step(ReferencePose(self._ids, goal, 0.0))).acknowledgements[0]

    async def connected(self) -> None:
        """Exchanges succeed."""
        await self.until(lambda: self.link.round_trip.count > 3)

    async def moving(self) -> "FieldbusRig":
        """This rig in the middle of a motion."""
        await self.connected()
        assert await self.command(CommandCode.ENABLE) is Reason.ACCEPTED
        await self.run(0.1)
        assert (await self.refer(0.25, 0.1)).reason is Reason.ACCEPTED
        await self.run(0.6)
        assert any(row.drives for row in self.registers.written[-3:])
        return self

    async def assert_completes(self) -> None:
        """Asserts that the motion ends where it should, without a fault."""
        await self.until(lambda: self.view.view.motion_done)
        view = self.view.view
        assert (view.group_state, view.fault) == (GroupState.STANDBY, FaultCode.NONE)
        assert max(abs(a - b) for a, b in zip(view.X_BT.p_m, view.X_BT_cmd.p_m, strict=True)) < 0.03

    def assert_safe(self, fault: FaultCode, since_ns: int, within_s: float) -> None:
        """Asserts SAFE: spools shut in time, no image enables any more, the cause latched."""
        limit_ns = since_ns + round(within_s * 1e9)
        assert self.now_ns > limit_ns + CLOSING_NS, "nothing can be said so early"
        assert_shut(self.registers, limit_ns + CLOSING_NS)
        late = [row for row in self.registers.written if row.time_ns > limit_ns and row.enables]
        assert not late, f"{(late[-1].time_ns - since_ns) / 1e6} ms after the fault: {late[-1]}"
        view = self.view.view
        assert (view.group_state, view.fault) == (GroupState.ERROR_STOP, fault)

    def assert_written_once(self) -> None:
        """Asserts that no image reached the registers twice, nor one after a newer one."""
        cycles = [row.image.controller_cycle for row in self.registers.written]
        assert all(b > a for a, b in pairwise(cycles)), "a blind repetition"


@asynccontextmanager
async def fieldbus(timeout_ms: float = 250.0) -> AsyncIterator[FieldbusRig]:
    """A rig whose exchanges count as failed after ``timeout_ms`` of real time."""
    registers = Registers(Plant(settings_of(1, ()).plant, 1))
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        _, port = await registers.coupler.start(bound)
        async with TcpProxy(port).serving() as proxy:
            rig = FieldbusRig(registers, proxy, timeout_ms)
            rig.link.start()
            try:
                yield rig
            finally:
                await rig.link.close()
        await registers.coupler.stop()
