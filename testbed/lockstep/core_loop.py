"""The controller's core closed over the plant's core through real process-image words; no sockets, no
clock."""

from collections.abc import Callable

from controller.core.scan import scan
from controller.core.scan_types import ControllerView, ScanInput, ScanOutput, initial_state
from controller.core.settings import ScanSettings
from plant_emulator.core.plant import Plant
from protocol.faults import CommandCode, Reason
from protocol.process_image import SensorImage, decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.reference_messages import FLAG_SETTLED, Command, ReferencePath, ReferencePose


class ClosedLoop:
    """Plant and controller in turn, one FC 23 exchange a cycle: the last scan's valves out, sensors in."""

    def __init__(self, settings: ScanSettings, plant: Plant) -> None:
        self.settings = settings
        self.plant = plant
        self.state = initial_state(settings)
        self.now_ns = 0
        self.link_alive = True
        self.outputs: ScanOutput | None = None
        self.watch: Callable[[SensorImage, ScanOutput], None] | None = None
        self._words: list[int] | None = None
        self._ids = 0

    @property
    def view(self) -> ControllerView:
        assert self.outputs is not None
        return self.outputs.view

    def step(self, *requests: Command | ReferencePose | ReferencePath) -> ScanOutput:
        """One cycle."""
        cycle_ns = round(self.settings.cycle_s * 1e9)
        if self._words is not None:
            self.plant.write(decode_valves(self._words))
        sensors = decode_sensors(encode_sensors(self.plant.read()))
        now_ns, dt_s = self.now_ns, self.settings.cycle_s
        inputs = ScanInput(now_ns, now_ns, dt_s, sensors, requests, self.link_alive)
        self.state, self.outputs = scan(self.settings, self.state, inputs)
        self._words = encode_valves(self.outputs.valves)
        if self.watch is not None:
            self.watch(sensors, self.outputs)
        self.plant.advance(cycle_ns)
        self.now_ns += cycle_ns
        return self.outputs

    def run(self, seconds: float) -> None:
        """Cycles for ``seconds``."""
        for _ in range(round(seconds / self.settings.cycle_s)):
            self.step()

    def command(self, code: CommandCode) -> Reason:
        """The answer to a command."""
        self._ids += 1
        return self.step(Command(self._ids, code)).acknowledgements[0].reason

    def enable(self) -> None:
        """Enabled, or an assertion."""
        self.step()
        assert self.command(CommandCode.ENABLE) is Reason.ACCEPTED

    def refer(self, make: Callable[[int], ReferencePose | ReferencePath]) -> Reason:
        """The answer to the reference that ``make`` gives for a fresh command id."""
        self._ids += 1
        return self.step(make(self._ids)).acknowledgements[0].reason

    def settle(self, timeout_s: float) -> float:
        """Seconds from now until the motion is done and settled; asserts that it comes to that."""
        for cycles in range(round(timeout_s / self.settings.cycle_s)):
            if self.view.motion_done and self.view.flags & FLAG_SETTLED:
                return cycles * self.settings.cycle_s
            self.step()
        raise AssertionError(f"not settled within {timeout_s} s: {self.view}")
