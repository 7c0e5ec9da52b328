"""The controller's programs in simulated time: the server session and the scan, on the controller's clock."""

from controller.core.excitation.plan import ExcitationPlan
from controller.core.excitation.program import ExcitationProgram, ExcitationSample
from controller.core.inbox import Inbox
from controller.core.scan_program import ScanProgram
from controller.core.scan_types import RuntimeStatistics, ScanInput, ScanOutput, to_state
from controller.shell.scan_recorder import ScanRecorder
from foundation.configuration import configuration_hash
from foundation.secret_source import read_key
from protocol.process_image import ValveImage, decode_sensors, encode_valves
from protocol.reference_messages import State
from protocol.server_session import ReferenceServer
from testbed.scenarios.settings import Settings

_VISION = "vision"


class ControllerSide:
    """The controller's programs: the server session and the scan, on the controller's clock.

    ``recorder``, where there is one, is told every scan. In the excitation mode ``excitation`` is its state,
    and ``samples`` all that it recorded.
    """

    def __init__(self, settings: Settings, seed: int) -> None:
        config = settings.controller
        self.cycle_ns = round(1e6 * config.cycle_ms)
        self._program = ScanProgram(settings.arm, config)
        self._inbox = Inbox()
        self._server = ReferenceServer(
            boot_id=seed + 1,
            arm_hash=configuration_hash(settings.arm),
            cycle_ns=self.cycle_ns,
            link_timeout_ms=config.reference_link.link_timeout_ms,
            capabilities=self._program.capabilities,
            key=read_key(config.reference_link.link_key),
        )
        self.valve_words = encode_valves(ValveImage(0, 0, (0.0,) * 6))
        self.recorder: ScanRecorder | None = None

    def cycle(
        self, sensor_words: list[int] | None, datagrams: list[bytes], arrival_ns: int, now_ns: int
    ) -> tuple[ScanOutput, list[bytes]]:
        """The scan's output and the datagrams to vision; ``valve_words`` are for the next exchange.

        ``sensor_words`` is None when the plant did not answer.
        """
        events = self._server.receive_batch([(data, _VISION) for data in datagrams], arrival_ns)
        events += self._server.tick(now_ns)
        for answer in self._inbox.put(events):
            self._server.acknowledge(answer, now_ns)
        requests, alive = self._inbox.take(self._server.link_alive(now_ns))
        inputs = ScanInput(
            now_ns=now_ns,
            sensed_ns=now_ns,
            dt_s=1e-9 * self.cycle_ns,
            sensors=None if sensor_words is None else decode_sensors(sensor_words),
            requests=requests,
            reference_link_alive=alive,
            streamed=self._inbox.take_streamed(),
        )
        output = self._program.scan(inputs)
        if self.recorder is not None:
            self.recorder.scan(inputs, output)
        for acknowledgement in output.acknowledgements:
            self._server.acknowledge(acknowledgement, now_ns)
        if output.refusal is not None:
            self._server.refuse_streamed(output.refusal, now_ns)
        if self._server.state_due(now_ns):
            self._server.publish(self._state_message(output), now_ns)
        self.valve_words = encode_valves(output.valves)
        return output, [data for data, _ in self._server.outgoing(now_ns)]

    @property
    def plan(self) -> ExcitationPlan | None:
        """What is tried out, None unless the excitation mode was chosen."""
        return self._program.plan

    @property
    def excitation(self) -> ExcitationProgram:
        """Where trying out stands."""
        return self._program.excitation

    @property
    def samples(self) -> list[ExcitationSample]:
        """All that was recorded of it."""
        return self._program.samples

    def _state_message(self, output: ScanOutput) -> State:
        """The state to publish: here no cycle is ever late."""
        link = self._server.statistics
        return to_state(output.view, RuntimeStatistics(0, 0, 0, 0, link.lost, link.dropped))
