"""Plant, controller and reference link in one simulated time: one thread, no sockets, bit-identical reruns.

Everything passes through the real codecs: sensor and valve words each cycle, datagrams through both
sessions, frame headers. Each part has a clock of its own, as three machines have, so that the clock mapping
is at work here too. A cycle follows the real controller's: exchange with the plant, scan, publish; the valve
image of a scan reaches the plant with the next exchange.
"""

from collections.abc import Callable
from typing import NamedTuple

from foundation.link_key import read_key
from plant_emulator.core.camera.camera_motion import STILL, CameraView, Capture
from plant_emulator.core.camera.exposures import Exposures, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.faults.kinds import CouplerSilent
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from protocol.client_session import ReferenceClient
from protocol.process_image import decode_valves, encode_sensors
from protocol.reference_messages import State
from protocol.stereo_frame import FrameHeader, decode_header, encode_header
from testbed.lockstep.clock import LockstepClock
from testbed.lockstep.controller_side import ControllerSide
from testbed.lockstep.link_record import LinkRecord
from testbed.lockstep.run_log import RunLog
from testbed.scenarios.settings import Settings
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.core.types import Image

CONTROLLER_CLOCK_NS = 3_600_000_000_000  # the three clocks differ, as those of three machines do
VISION_CLOCK_NS = 7_200_000_000_000
TRUTH_PERIOD_NS = 20_000_000
_CONNECT_S = 5.0

Wire = Callable[[list[bytes]], list[bytes]]


class Frame(NamedTuple):
    """A stereo pair as it arrives; the header's times are on the camera's clock, the simulated time."""

    header: FrameHeader
    left: Image
    right: Image


class World:
    """The physical world, the controller, and vision's end of the reference link.

    ``clock`` alone lets time pass, a controller cycle at a time. ``link`` is the shipped client of the
    reference link, and ``states`` all that it received. ``on_frame`` is called with each stereo pair while it
    is set; no picture is rendered otherwise. ``on_exposure`` is called at the same instants with the frame's
    number and the truth, for those who judge pictures or stand in for them. ``to_controller`` and
    ``to_vision`` turn the datagrams sent in a cycle into those that arrive in it: a wire that loses, repeats
    or reorders. They are sent and arrive ``lead_ns``, less than a cycle, before its scan.
    """

    def __init__(self, settings: Settings, seed: int, log: RunLog) -> None:
        scene = Scene(settings.scene)
        self.log = log
        self.settings = settings
        self.plant = Plant(settings.plant, seed, scene.mounts)
        self.truths: list[PlantTruth] = []
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
        self._time_ns = 0
        self.frame_period_ns = round(1e9 / settings.scene.camera.rate_hz)
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

    def step(self) -> None:
        """Pass one controller cycle; for the clock alone."""
        self.link.tick()
        datagrams = self.to_controller(self.link.outgoing(self.vision_ns - self.lead_ns))
        sensor_words = self._exchanged()
        scan_ns = self._time_ns + CONTROLLER_CLOCK_NS
        output, replies = self._controller.cycle(sensor_words, datagrams, scan_ns - self.lead_ns, scan_ns)
        for event in output.events:
            self.log.add(self._time_ns, "controller", what=event)
        for data in self.to_vision(replies):
            self.link.receive(data)
        self._pass_time(self._time_ns + self._controller.cycle_ns)

    def _exchanged(self) -> list[int] | None:
        """The plant's sensor words, after it was given the controller's valves; None while it is silent."""
        if self.plant.faults.of_kind(CouplerSilent):
            return None
        self.plant.write(decode_valves(self._controller.valve_words))
        return encode_sensors(self.plant.read())

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
        capture = Capture(frame_id, self._time_ns, CameraView(truth.X_WC, truth.X_WM), motion)
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
