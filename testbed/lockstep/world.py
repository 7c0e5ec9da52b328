"""Plant, controller and reference link in one simulated time: one thread, no sockets, bit-identical reruns.

Everything passes through the real codecs: sensor and valve words each cycle, datagrams through both
sessions, frame headers. Each part has a clock of its own, as three machines have, so that the clock mapping
is at work here too. A cycle follows the real controller's: exchange with the plant, scan, publish; the valve
image of a scan reaches the plant with the next exchange.
"""

from collections.abc import Callable
from typing import NamedTuple

from controller.core.inbox import Inbox
from controller.core.scan import scan
from controller.core.scan_types import ScanInput, ScanOutput, initial_state
from controller.core.settings import settings_from
from foundation.configuration import configuration_hash
from foundation.link_key import read_key
from plant_emulator.core.camera.camera_motion import STILL, Capture, View
from plant_emulator.core.camera.exposures import Exposures, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.faults.kinds import CouplerSilent
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from protocol.channel import LinkStatistics
from protocol.client_session import ReferenceClient
from protocol.clock_offset import OffsetEstimate
from protocol.faults import FaultCode, GroupState
from protocol.process_image import ValveImage, decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.reference_messages import Acknowledgement, Request, State, StreamedPose, StreamRefused
from protocol.server_session import ReferenceServer
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    DatagramDropped,
    LinkLost,
    StateReceived,
    StreamRefusedReceived,
)
from protocol.stereo_frame import FrameHeader, decode_header, encode_header
from testbed.lockstep.run_log import RunLog
from testbed.scenarios.settings import Settings
from vision_pc.core.types import Image

CONTROLLER_CLOCK_NS = 3_600_000_000_000  # the three clocks differ, as those of three machines do
VISION_CLOCK_NS = 7_200_000_000_000
TRUTH_PERIOD_NS = 20_000_000
_VISION = "vision"


Wire = Callable[[list[bytes]], list[bytes]]


class Frame(NamedTuple):
    """A stereo pair as it arrives; the header's times are on the camera's clock, the simulated time."""

    header: FrameHeader
    left: Image
    right: Image


class ControllerSide:
    """The controller's programs: the server session and the scan, on the controller's clock."""

    def __init__(self, settings: Settings, seed: int) -> None:
        config = settings.controller
        self.cycle_ns = round(1e6 * config.cycle_ms)
        self._settings = settings_from(settings.arm, config)
        self._state = initial_state(self._settings)
        self._inbox = Inbox()
        self._server = ReferenceServer(
            boot_id=seed + 1,
            arm_hash=configuration_hash(settings.arm),
            cycle_ns=self.cycle_ns,
            link_timeout_ms=config.reference_link.link_timeout_ms,
            key=read_key(config.reference_link.link_key),
        )
        self.valve_words = encode_valves(ValveImage(0, 0, (0.0,) * 6))

    def cycle(
        self, sensor_words: list[int] | None, datagrams: list[bytes], arrival_ns: int, now_ns: int
    ) -> tuple[ScanOutput, list[bytes]]:
        """The scan's output and the datagrams to vision; ``valve_words`` are for the next exchange.

        ``sensor_words`` is None when the plant did not answer.
        """
        events = self._server.receive_batch([(data, _VISION) for data in datagrams], arrival_ns)
        events += self._server.tick(now_ns)
        self._inbox.put(events)
        requests, alive = self._inbox.take(self._server.link_alive(now_ns))
        self._state, output = scan(
            self._settings,
            self._state,
            ScanInput(
                now_ns=now_ns,
                dt_s=1e-9 * self.cycle_ns,
                sensors=None if sensor_words is None else decode_sensors(sensor_words),
                requests=requests,
                reference_link_alive=alive,
                streamed=self._inbox.take_streamed(),
            ),
        )
        for acknowledgement in output.acknowledgements:
            self._server.acknowledge(acknowledgement, now_ns)
        if output.refusal is not None:
            self._server.refuse_streamed(output.refusal, now_ns)
        self._server.publish(self._state_message(output), now_ns)
        self.valve_words = encode_valves(output.valves)
        return output, [data for data, _ in self._server.outgoing(now_ns)]

    def _state_message(self, output: ScanOutput) -> State:
        """The state to publish: here no cycle is ever late."""
        lost = self._server.statistics
        return State(
            **output.view._asdict(),
            overruns=0,
            lateness_p50_us=0,
            lateness_p99_us=0,
            lateness_max_us=0,
            references_lost=lost.lost,
            references_dropped=lost.dropped,
        )


class World:
    """The physical world, the controller, and vision's end of the reference link.

    ``step`` lets one controller cycle pass. ``on_frame`` is called with each stereo pair while it is set; no
    picture is rendered otherwise. ``on_exposure`` is called at the same instants with the frame's number and
    the truth, for those who judge pictures or stand in for them. ``to_controller`` and ``to_vision`` turn the
    datagrams sent in a cycle into those that arrive in it: a wire that loses, repeats or reorders. They are
    sent and arrive ``lead_ns``, less than a cycle, before its scan.
    """

    def __init__(self, settings: Settings, seed: int, log: RunLog) -> None:
        scene = Scene(settings.scene)
        self.log = log
        self.settings = settings
        self.plant = Plant(settings.plant, seed, scene.mounts)
        self.truths: list[PlantTruth] = []
        self.states: list[State] = []
        self.acknowledgements: dict[int, Acknowledgement] = {}
        self.refusals: dict[int, StreamRefused] = {}
        self.link_lost: LinkLost | None = None
        self.lead_ns = 0
        self.to_controller: Wire = list
        self.to_vision: Wire = list
        self.on_frame: Callable[[Frame], None] | None = None
        self.on_exposure: Callable[[int, PlantTruth], None] | None = None
        self._camera: StereoCamera | None = None
        self._exposures = Exposures(settings.scene.camera, settings.scene.seed)
        self._fault_changes_told = 0
        self._scene = scene
        self._controller = ControllerSide(settings, seed)
        self._client = ReferenceClient(
            nonce=seed + 1,
            arm_hash=configuration_hash(settings.arm),
            state_period_ms=settings.vision.link.state_period_ms,
            key=read_key(settings.vision.link.link_key),
        )
        self._time_ns = 0
        self.frame_period_ns = round(1e9 / settings.scene.camera.rate_hz)
        self._client.connect(self.vision_ns)

    @property
    def time_ns(self) -> int:
        """The simulated time; the plant's and the camera's clock."""
        return self._time_ns

    @property
    def vision_ns(self) -> int:
        """The time on vision's clock."""
        return self._time_ns + VISION_CLOCK_NS

    @property
    def clock(self) -> OffsetEstimate | None:
        """The controller's clock minus vision's, as vision's session has estimated it."""
        return self._client.clock

    @property
    def authenticated(self) -> bool:
        """Whether vision's session is authenticated."""
        return self._client.authenticated

    @property
    def link_statistics(self) -> LinkStatistics:
        """Counters of vision's session."""
        return self._client.statistics

    @property
    def connected(self) -> bool:
        """Whether the reference link is open and its clocks are known."""
        return self._client.connected and self._client.clock is not None and bool(self.states)

    def submit(self, request: Request) -> int:
        """The id under which vision's session sends ``request``."""
        command_id = self._client.submit(request, self.vision_ns)
        self.log.add(self._time_ns, "request", id=command_id, kind=type(request).__name__)
        return command_id

    def stream(self, reference: StreamedPose) -> None:
        """Sends a streamed reference with the next cycle. Raises LinkLost when there is no session."""
        self._client.stream(reference, self.vision_ns)

    def disconnect(self) -> None:
        """Vision ends its session, and says so with the next cycle."""
        for event in self._client.disconnect(self.vision_ns):
            self._noted(event)

    def step(self) -> None:
        """Advance the world by one controller cycle."""
        for said in self._client.tick(self.vision_ns):
            self._noted(said)
        datagrams = self.to_controller(self._client.outgoing(self.vision_ns - self.lead_ns))
        sensor_words = self._exchanged()
        before = self.states[-1] if self.states else None
        scan_ns = self._time_ns + CONTROLLER_CLOCK_NS
        output, replies = self._controller.cycle(sensor_words, datagrams, scan_ns - self.lead_ns, scan_ns)
        for event in output.events:
            self.log.add(self._time_ns, "controller", what=event)
        for data in self.to_vision(replies):
            self._received(data)
        if self.states and (before is None or _noteworthy(before, self.states[-1])):
            self._log_state(self.states[-1])
        self._pass_time(self._time_ns + self._controller.cycle_ns)

    def _exchanged(self) -> list[int] | None:
        """The plant's sensor words, after it was given the controller's valves; None while it is silent."""
        if self.plant.faults.of_kind(CouplerSilent):
            return None
        self.plant.write(decode_valves(self._controller.valve_words))
        return encode_sensors(self.plant.read())

    def _received(self, data: bytes) -> None:
        for event in self._client.receive(data, self.vision_ns):
            self._noted(event)

    def _noted(self, event: ClientEvent) -> None:
        if isinstance(event, StateReceived):
            self.states.append(event.state)
        elif isinstance(event, AcknowledgementReceived):
            answer = event.acknowledgement
            self.acknowledgements[answer.command_id] = answer
            self.log.add(self._time_ns, "acknowledgement", id=answer.command_id, reason=answer.reason.name)
        elif isinstance(event, StreamRefusedReceived):
            self.refusals.setdefault(event.refusal.stream_id, event.refusal)
            self.log.add(self._time_ns, "stream_refused", reason=event.refusal.reason.name)
        elif isinstance(event, LinkLost):
            self.link_lost = event
            self.log.add(self._time_ns, "link_lost", reason=event.reason.name)
        elif isinstance(event, DatagramDropped):
            self.log.add(self._time_ns, "datagram_dropped", cause=event.cause)

    def _log_state(self, state: State) -> None:
        self.log.add(
            self._time_ns,
            "state",
            group=GroupState(state.group_state).name,
            fault=FaultCode(state.fault).name,
            motion=state.motion_id,
            segment=state.segment,
            p_m=state.X_BT.p_m,
        )

    def _pass_time(self, until_ns: int) -> None:
        """Advance the plant to ``until_ns``; record truth and take pictures on the way."""
        while self._time_ns < until_ns:
            stop_ns = min(
                until_ns, _next(self._time_ns, TRUTH_PERIOD_NS), _next(self._time_ns, self.frame_period_ns)
            )
            self.plant.advance(stop_ns - self._time_ns)
            self._time_ns = stop_ns
            self._tell_faults()
            if stop_ns % TRUTH_PERIOD_NS == 0:
                self.truths.append(self.plant.truth())
            if stop_ns % self.frame_period_ns == 0:
                self._expose(self.plant.truth())

    def _tell_faults(self) -> None:
        for change in self.plant.faults.changes[self._fault_changes_told :]:
            self.log.add(change.time_ns, "fault", **change.injection.as_dict(), phase=change.phase)
            self._fault_changes_told += 1

    def _expose(self, truth: PlantTruth) -> None:
        frame_id = self._time_ns // self.frame_period_ns
        motion = self.plant.motion() if self.settings.scene.camera.shows_motion else STILL
        capture = Capture(frame_id, self._time_ns, View(truth.X_WC, truth.X_WM), motion)
        shot = self._exposures.shot(capture, self.plant.faults.in_force())
        if self.on_exposure is not None:
            self.on_exposure(frame_id, truth)
        if self.on_frame is not None and shot.delivered:
            self.on_frame(self._photograph(shot))

    def _photograph(self, shot: Shot) -> Frame:
        config = self.settings.scene.camera
        if self._camera is None:
            self._camera = StereoCamera(config, self._scene, self.settings.scene.seed)
        header = FrameHeader(
            frame_id=shot.frame_id,
            capture_ns=shot.capture_ns,
            send_ns=self._time_ns,
            width=config.width_px,
            height=config.height_px,
            exposure_us=config.exposure_us,
            flags=0,
        )
        left, right = self._camera.take(shot)
        return Frame(decode_header(encode_header(header)), left, right)


def _next(time_ns: int, period_ns: int) -> int:
    """The first multiple of ``period_ns`` after ``time_ns``."""
    return (time_ns // period_ns + 1) * period_ns


def _noteworthy(before: State, after: State) -> bool:
    """Whether something changed that a reader of the event log wants to know."""
    return (before.group_state, before.fault, before.motion_id, before.motion_done, before.segment) != (
        after.group_state,
        after.fault,
        after.motion_id,
        after.motion_done,
        after.segment,
    )
