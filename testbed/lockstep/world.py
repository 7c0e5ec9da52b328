"""Plant, controller and reference link in one simulated time: one thread, no sockets, bit-identical reruns.

Everything passes through the real codecs: sensor and valve words each cycle, datagrams through both
sessions. Each part has a clock of its own, as three machines have, so that the clock mapping
is at work here too. A cycle follows the real controller's: exchange with the plant, scan, publish; the valve
image of a scan reaches the plant with the next exchange.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from controller.core.inbox import Inbox
from controller.core.scan_program import Parts, own_parts
from controller.core.scan_types import RuntimeStatistics, ScanInput, ScanOutput, to_state
from controller.shell.scan_recorder import ScanRecorder
from foundation.event_log import Level
from foundation.recording.beginning import SESSION_VARIABLE, session_entries
from foundation.recording.messages import DirectRecording
from foundation.secret_source import read_key
from nominal_arm.dimensions import joint_ranges
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.faults.kinds import CouplerSilent
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.scene_messages import drawing
from plant_emulator.shell.truth_recorder import TruthRecorder
from protocol.client_session import ReferenceClient
from protocol.faults import GroupState
from protocol.process_image import ValveImage, decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.reference_messages import State
from protocol.session_events import ClientEvent, StateReceived
from testbed.lockstep.camera_side import CameraSide
from testbed.lockstep.clock import LockstepClock, RunLog
from testbed.scenarios.scenario import Settings
from vision_pc.application.reference_link import ReferenceLink, Streamed, Submitted
from vision_pc.shell.link.udp_endpoint import LinkJournal

_VISION = "vision"


class ControllerSide:
    """The controller's programs: the server session and the scan, on the controller's clock.

    ``recorder``, where there is one, is told every scan. In the excitation mode ``program`` has its plan,
    its state, and all that it recorded.
    """

    def __init__(self, settings: Settings, seed: int, parts: Parts = own_parts) -> None:
        config = settings.controller
        self.cycle_ns = round(1e6 * config.cycle_ms)
        self._inbox = Inbox()
        key = read_key(config.reference_link.link_key)
        self.program, self._server = parts(settings.arm, config, seed + 1, key)
        self.valve_words = encode_valves(ValveImage(0, 0, (0.0,) * 6))
        self.recorder: ScanRecorder | None = None

    def cycle(
        self, sensor_words: list[int] | None, datagrams: list[bytes], now_ns: int
    ) -> tuple[ScanOutput, list[bytes]]:
        """The scan's output and the datagrams to vision; ``valve_words`` are for the next exchange.

        ``sensor_words`` is None when the plant did not answer.
        """
        events = self._server.receive_batch([(data, _VISION) for data in datagrams], now_ns)
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
        output = self.program.scan(inputs)
        if self.recorder is not None:
            self.recorder.scan(inputs, output)
        for acknowledgement in output.acknowledgements:
            self._server.acknowledge(acknowledgement, now_ns)
        if output.refusal is not None:
            self._server.refuse_streamed(output.refusal, now_ns)
        if self._server.state_due(now_ns):
            link = self._server.statistics  # no cycle is ever late here
            statistics = RuntimeStatistics(0, 0, 0, 0, link.lost, link.dropped)
            self._server.publish(to_state(output.view, statistics), now_ns)
        self.valve_words = encode_valves(output.valves)
        return output, [data for data, _ in self._server.outgoing(now_ns)]


CONTROLLER_CLOCK_NS = 3_600_000_000_000  # the three clocks differ, as those of three machines do
VISION_CLOCK_NS = 7_200_000_000_000
TRUTH_PERIOD_NS = 20_000_000
_CONNECT_S = 5.0

Wire = Callable[[list[bytes]], list[bytes]]


class World:
    """The physical world, the controller, and vision's end of the reference link.

    ``clock`` alone lets time pass, a controller cycle at a time; ``time_ns`` is the simulated time, the
    plant's and the camera's clock. ``controller`` is the controller's end of
    the reference link, ``link`` the shipped client, ``states`` all that it received. ``camera`` exposes at
    its own rate. ``to_controller`` and ``to_vision`` turn the datagrams sent in a cycle into those that
    arrive in it: a wire that loses, repeats or reorders. ``parts`` make the controller's scan and sessions.
    """

    def __init__(self, settings: Settings, seed: int, log: RunLog, parts: Parts = own_parts) -> None:
        self.log = log
        self.settings = settings
        self.plant = Plant(settings.plant, seed, Scene(settings.scene).mounts)
        self.camera = CameraSide(settings)
        self.truths: list[PlantTruth] = []
        self.recording: TruthRecorder | None = None
        self.to_controller: Wire = list
        self.to_vision: Wire = list
        self._fault_changes_logged = 0
        self.controller = ControllerSide(settings, seed, parts)
        self.time_ns = 0
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
        self.states: list[State] = []
        journal = LinkJournal(SimulatedTimeLog(self), self.clock)
        self.link = ReferenceLink(session, self.clock, lambda: None, journal, "controller")
        self.link.listeners.append(self._on_heard)
        self.link.ranges = joint_ranges(settings.arm)
        self.link.connect()

    @property
    def vision_ns(self) -> int:
        """The time on vision's clock."""
        return self.time_ns + VISION_CLOCK_NS

    def _on_heard(self, event: Submitted | Streamed | ClientEvent) -> None:
        """Keep every state; where the tool is then, the log tells as the group's state changes."""
        if isinstance(event, StateReceived):
            before = self.states[-1].group_state if self.states else None
            self.states.append(event.state)
            if event.state.group_state is not before:
                group = GroupState(event.state.group_state).name
                self.log.add(self.time_ns, "state", group=group, p_m=event.state.X_BT.p_m)

    def connect(self) -> None:
        """Let time pass until the reference link is open, at most 5 s."""
        self.clock.advance_until(lambda: self.link.connected, _CONNECT_S)

    def record_in(self, path: Path, session: str) -> TruthRecorder:
        """Record the truth from now on in ``path``, in simulated time, until what is returned is closed.

        The same run gives the same bytes. Raises FileExistsError where the file exists, OSError when it
        cannot be written.
        """
        run = {name: getattr(self.settings, name).model_dump(mode="json") for name in ("plant", "scene")}
        drawn = drawing(self.settings.scene, self.plant.chain, self.plant.time_ns)
        entries = session_entries("plant_emulator", {SESSION_VARIABLE: session})
        self.recording = TruthRecorder(path, run, drawn, entries, DirectRecording)
        return self.recording

    def step(self) -> None:
        """Pass one controller cycle; for the clock alone."""
        self.link.tick()
        datagrams = self.to_controller(self.link.outgoing(self.vision_ns))
        sensor_words = self._exchange()
        scan_ns = self.time_ns + CONTROLLER_CLOCK_NS
        output, replies = self.controller.cycle(sensor_words, datagrams, scan_ns)
        for event in output.events:
            self.log.add(self.time_ns, "controller", what=event)
        for data in self.to_vision(replies):
            self.link.receive(data)
        self._pass_time(self.time_ns + self.controller.cycle_ns)

    def _exchange(self) -> list[int] | None:
        """The plant's sensor words, after it was given the controller's valves; None while it is silent."""
        if self.plant.faults.of_kind(CouplerSilent):
            return None
        self.plant.write(decode_valves(self.controller.valve_words))
        return encode_sensors(self.plant.read())

    def _pass_time(self, until_ns: int) -> None:
        """Advance the plant to ``until_ns``; record truth and take pictures on the way."""
        while self.time_ns < until_ns:
            stop_ns = min(
                until_ns, _next(self.time_ns, TRUTH_PERIOD_NS), _next(self.time_ns, self.camera.period_ns)
            )
            self.plant.advance(stop_ns - self.time_ns)
            self.time_ns = stop_ns
            self._tell_faults()
            if stop_ns % TRUTH_PERIOD_NS == 0:
                self.truths.append(self.plant.truth())
                if self.recording is not None and stop_ns % self.camera.period_ns:
                    self.recording.truth(self.truths[-1], stop_ns, self.plant.links())
            if stop_ns % self.camera.period_ns == 0:
                truth, shot, motion = self.camera.expose(stop_ns, self.plant)
                if self.recording is not None:
                    self.recording.capture(truth, stop_ns, shot.frame_id, self.plant.links(), motion)

    def _tell_faults(self) -> None:
        for change in self.plant.faults.changes[self._fault_changes_logged :]:
            self.log.add(change.time_ns, "fault", **change.injection.as_dict(), phase=change.phase)
            self._fault_changes_logged += 1
            if self.recording is not None:
                self.recording.fault(change, change.time_ns)


class SimulatedTimeLog:
    """The application's events, written to the run's log with simulated time."""

    healthy = True

    def __init__(self, world: World) -> None:
        self._world = world
        self.listener: Callable[[str, Level, dict[str, Any]], object] | None = None

    def write(self, event: str, level: Level = "info", /, **fields: Any) -> None:
        """Append one event, and tell it to the listener."""
        self._world.log.add(self._world.time_ns, event, **fields)
        if self.listener is not None:
            self.listener(event, level, fields)


def _next(time_ns: int, period_ns: int) -> int:
    """The first multiple of ``period_ns`` after ``time_ns``."""
    return (time_ns // period_ns + 1) * period_ns
