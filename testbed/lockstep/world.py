"""Plant, controller and reference link in one simulated time: one thread, no sockets, bit-identical reruns.

Everything passes through the real codecs: sensor and valve words each cycle, datagrams through both
sessions, frame headers. Each part has a clock of its own, as three machines have, so that the clock mapping
is at work here too. A cycle follows the real controller's: exchange with the plant, scan, publish; the valve
image of a scan reaches the plant with the next exchange.
"""

from collections.abc import Callable
from pathlib import Path

from controller.core.excitation.plan import ExcitationPlan
from controller.core.excitation.program import ExcitationProgram, ExcitationSample
from controller.core.inbox import Inbox
from controller.core.scan_program import Parts, own_parts
from controller.core.scan_types import RuntimeStatistics, ScanInput, ScanOutput, to_state
from controller.shell.scan_recorder import ScanRecorder
from foundation.secret_source import read_key
from nominal_arm.dimensions import joint_ranges
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.faults.kinds import CouplerSilent
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from protocol.client_session import ReferenceClient
from protocol.faults import FaultCode, GroupState
from protocol.process_image import ValveImage, decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.reference_messages import State
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    DatagramDropped,
    SessionLost,
    StateReceived,
    StreamRefusedReceived,
)
from testbed.lockstep.camera_side import CameraSide, LockstepRecording
from testbed.lockstep.clock import LockstepClock, RunLog
from testbed.scenarios.scenario import Settings
from vision_pc.application.reference_link import ReferenceLink, Streamed, Submitted


class LinkRecord:
    """Implements ``vision_pc.application.reference_link.Journal``; ``states`` are all that came."""

    def __init__(self, log: RunLog, clock: LockstepClock) -> None:
        self.states: list[State] = []
        self._log = log
        self._clock = clock

    def __call__(self, event: Submitted | Streamed | ClientEvent) -> None:
        """Write what a reader of the run's log wants to know of ``event``."""
        if isinstance(event, StateReceived):
            self._receive_state(event.state)
        elif isinstance(event, Submitted):
            self._add("request", id=event.command_id, kind=type(event.request).__name__)
        elif isinstance(event, AcknowledgementReceived):
            answer = event.acknowledgement
            self._add("acknowledgement", id=answer.command_id, reason=answer.reason.name)
        elif isinstance(event, StreamRefusedReceived):
            self._add("stream_refused", reason=event.refusal.reason.name)
        elif isinstance(event, SessionLost):
            self._add("link_lost", reason=event.reason.name)
        elif isinstance(event, DatagramDropped):
            self._add("datagram_dropped", cause=event.cause)

    def _receive_state(self, state: State) -> None:
        if not self.states or _noteworthy(self.states[-1], state):
            self._add(
                "state",
                group=GroupState(state.group_state).name,
                fault=FaultCode(state.fault).name,
                motion=state.motion_id,
                segment=state.segment,
                p_m=state.X_BT.p_m,
            )
        self.states.append(state)

    def _add(self, event: str, **fields: object) -> None:
        self._log.add(self._clock.time_ns, event, **fields)


def _noteworthy(before: State, after: State) -> bool:
    """Return True if something changed that a reader of the event log wants to know."""
    return (before.group_state, before.fault, before.motion_id, before.motion_done, before.segment) != (
        after.group_state,
        after.fault,
        after.motion_id,
        after.motion_done,
        after.segment,
    )


_VISION = "vision"


class ControllerSide:
    """The controller's programs: the server session and the scan, on the controller's clock.

    ``recorder``, where there is one, is told every scan. In the excitation mode ``excitation`` is its state,
    and ``samples`` all that it recorded.
    """

    def __init__(self, settings: Settings, seed: int, parts: Parts = own_parts) -> None:
        config = settings.controller
        self.cycle_ns = round(1e6 * config.cycle_ms)
        self._inbox = Inbox()
        key = read_key(config.reference_link.link_key)
        self._program, self._server = parts(settings.arm, config, seed + 1, key)
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


CONTROLLER_CLOCK_NS = 3_600_000_000_000  # the three clocks differ, as those of three machines do
VISION_CLOCK_NS = 7_200_000_000_000
TRUTH_PERIOD_NS = 20_000_000
_CONNECT_S = 5.0

Wire = Callable[[list[bytes]], list[bytes]]


class World:
    """The physical world, the controller, and vision's end of the reference link.

    ``clock`` alone lets time pass, a controller cycle at a time. ``controller`` is the controller's end of
    the reference link, ``link`` the shipped client, ``states`` all that it received. ``camera`` exposes at
    its own rate. ``to_controller`` and ``to_vision`` turn the datagrams sent in a cycle into those that
    arrive in it: a wire that loses, repeats or reorders. They are sent and arrive ``lead_ns``, less than a
    cycle, before its scan. ``parts`` make the controller's scan and sessions.
    """

    def __init__(self, settings: Settings, seed: int, log: RunLog, parts: Parts = own_parts) -> None:
        self.log = log
        self.settings = settings
        self.plant = Plant(settings.plant, seed, Scene(settings.scene).mounts)
        self.camera = CameraSide(settings)
        self.truths: list[PlantTruth] = []
        self.recording: LockstepRecording | None = None
        self.lead_ns = 0
        self.to_controller: Wire = list
        self.to_vision: Wire = list
        self._fault_changes_told = 0
        self.controller = ControllerSide(settings, seed, parts)
        self._time_ns = 0
        self.clock = LockstepClock(self)
        self.open_link(nonce=seed + 1)

    def open_link(self, nonce: int, first_sequence: int = 1) -> None:
        """Give vision a new link with a session of its own, as a new run of its program has."""
        settings = self.settings
        session = ReferenceClient(
            nonce=nonce,
            arm_hash=settings.vision.link.expected_arm(settings.arm),
            state_period_ms=settings.vision.link.state_period_ms,
            first_sequence=first_sequence,
            key=read_key(settings.vision.link.link_key),
        )
        self.record = LinkRecord(self.log, self.clock)
        self.link = ReferenceLink(session, self.clock, self.clock, self.record, "controller")
        self.link.ranges = joint_ranges(settings.arm)
        self.link.connect()

    @property
    def time_ns(self) -> int:
        """The simulated time; the plant's and the camera's clock."""
        return self._time_ns

    @property
    def vision_ns(self) -> int:
        """The time on vision's clock."""
        return self._time_ns + VISION_CLOCK_NS

    @property
    def states(self) -> list[State]:
        """All states that vision received."""
        return self.record.states

    @property
    def connected(self) -> bool:
        """Return True if the reference link is open and its clocks are known."""
        return self.link.connected and self.link.clock_offset is not None

    def connect(self) -> None:
        """Let time pass until the reference link is open, at most 5 s."""
        self.clock.advance_until(lambda: self.connected, _CONNECT_S)

    def record_in(self, path: Path, session: str) -> None:
        """Record the truth from now on in ``path``, until ``recording`` is closed. Raises OSError."""
        self.recording = LockstepRecording(path, session, self.settings, self.plant, self.camera)

    def step(self) -> None:
        """Pass one controller cycle; for the clock alone."""
        self.link.tick()
        datagrams = self.to_controller(self.link.outgoing(self.vision_ns - self.lead_ns))
        sensor_words = self._exchange()
        scan_ns = self._time_ns + CONTROLLER_CLOCK_NS
        output, replies = self.controller.cycle(sensor_words, datagrams, scan_ns - self.lead_ns, scan_ns)
        for event in output.events:
            self.log.add(self._time_ns, "controller", what=event)
        for data in self.to_vision(replies):
            self.link.receive(data)
        self._pass_time(self._time_ns + self.controller.cycle_ns)

    def _exchange(self) -> list[int] | None:
        """The plant's sensor words, after it was given the controller's valves; None while it is silent."""
        if self.plant.faults.of_kind(CouplerSilent):
            return None
        self.plant.write(decode_valves(self.controller.valve_words))
        return encode_sensors(self.plant.read())

    def _pass_time(self, until_ns: int) -> None:
        """Advance the plant to ``until_ns``; record truth and take pictures on the way."""
        while self._time_ns < until_ns:
            stop_ns = min(
                until_ns, _next(self._time_ns, TRUTH_PERIOD_NS), _next(self._time_ns, self.camera.period_ns)
            )
            self.plant.advance(stop_ns - self._time_ns)
            self._time_ns = stop_ns
            self._tell_faults()
            if stop_ns % TRUTH_PERIOD_NS == 0:
                self.truths.append(self.plant.truth())
                if self.recording is not None:
                    self.recording.truth(self.truths[-1])
            if stop_ns % self.camera.period_ns == 0:
                self.camera.expose(stop_ns, self.plant)

    def _tell_faults(self) -> None:
        for change in self.plant.faults.changes[self._fault_changes_told :]:
            self.log.add(change.time_ns, "fault", **change.injection.as_dict(), phase=change.phase)
            self._fault_changes_told += 1
            if self.recording is not None:
                self.recording.fault(change)


def _next(time_ns: int, period_ns: int) -> int:
    """The first multiple of ``period_ns`` after ``time_ns``."""
    return (time_ns // period_ns + 1) * period_ns
