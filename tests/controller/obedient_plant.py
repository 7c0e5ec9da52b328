"""A plant that does at once what it is told: joints stand where the controller's command stands.

It serves tests of states and supervision, where physics would only be in the way; every duty of a real
plant (cycle, echo, status bits) can be made to fail.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from controller.core.scan import scan
from controller.core.scan_types import ScanInput, ScanOutput, initial_state
from controller.core.settings import ScanSettings
from protocol.faults import CommandCode, Reason
from protocol.pose import Pose
from protocol.process_image import (
    CONTROL_ENABLE,
    CONTROL_RESET_WATCHDOG,
    COUNTS_PER_TURN,
    STATUS_SUPPLY_ON,
    STATUS_VALVES_ENABLED,
    STATUS_WATCHDOG_TRIPPED,
    SensorImage,
)
from protocol.reference_messages import (
    Acknowledgement,
    Command,
    ReferencePose,
    Request,
    StreamedPose,
    StreamRefused,
)
from protocol.session_events import StreamedPoseReceived

START_DEG = (0.0, 50.0, -75.0, 0.0, -25.0, 0.0)


def counts(q: tuple[float, ...]) -> tuple[int, int, int, int, int, int]:
    """Encoder counts of joint angles (rad)."""
    a, b, c, d, e, f = (round(angle * COUNTS_PER_TURN / (2.0 * math.pi)) for angle in q)
    return a, b, c, d, e, f


@dataclass
class Bench:
    """A controller and an obedient plant; the fields below the line are the plant's misbehaviour."""

    settings: ScanSettings
    q: tuple[float, ...] = tuple(math.radians(angle) for angle in START_DEG)
    now_ns: int = 0
    link_alive: bool = True
    # ---
    silent: bool = False
    frozen: bool = False
    deaf: bool = False
    stuck: bool = False
    enables: bool = True
    hears_reset: bool = True
    status: int = STATUS_SUPPLY_ON
    supply_bar: float = 190.0
    late_s: float = 0.0
    offset: tuple[float, ...] = (0.0,) * 6
    outputs: list[ScanOutput] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state = initial_state(self.settings)
        self.plant_cycle = 0
        self.echo = 0

    @property
    def last(self) -> ScanOutput:
        return self.outputs[-1]

    def step(self, *requests: Request, arrival: StreamedPoseReceived | None = None) -> ScanOutput:
        """One scan, in which ``arrival`` is the newest streamed reference."""
        sensors = None if self.silent else self._exchange()
        dt_s = self.settings.cycle_s + self.late_s
        self.late_s = 0.0
        self.now_ns += round(dt_s * 1e9)
        inputs = ScanInput(self.now_ns, self.now_ns, dt_s, sensors, requests, self.link_alive, arrival)
        self.state, output = scan(self.settings, self.state, inputs)
        self.outputs.append(output)
        return output

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.settings.cycle_s)):
            self.step()

    def command(self, code: CommandCode) -> Reason:
        return self.step(Command(len(self.outputs) + 1, code)).acknowledgements[0].reason

    def refer(self, pose: Pose, duration_s: float = 0.0) -> Acknowledgement:
        return self.step(ReferencePose(len(self.outputs) + 1, pose, duration_s)).acknowledgements[0]

    def shifted(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Pose:
        """The present tool pose, moved."""
        here = self.last.view.X_BT
        return Pose((here.p_m[0] + x, here.p_m[1] + y, here.p_m[2] + z), here.q_wxyz)

    def enabled(self) -> "Bench":
        """This bench, in standby."""
        self.step()
        assert self.command(CommandCode.ENABLE) is Reason.ACCEPTED
        self.step()
        return self

    def streaming(self) -> "Bench":
        """This bench, following a stream in the middle of a motion of 0.3 m; the next number is 1000."""
        self.enabled()
        self.open_stream()
        goal = self.shifted(z=0.3)
        for number in range(1, 1000):
            if number > 50 and np.linalg.norm(self.state.motion.desired.v) > 0.1:
                break
            self.stream(number, goal)
        return self

    def open_stream(self) -> int:
        """The id of a new stream."""
        assert self.command(CommandCode.START_STREAM) is Reason.ACCEPTED
        return self.last.acknowledgements[0].command_id

    def stream(self, number: int, pose: Pose, **more: Any) -> StreamRefused | None:
        """The refusal of a reference of the open stream; ``more``: stream_id, twist_ref, age_s."""
        age_s = more.pop("age_s", 0.0)
        stream_id = more.pop("stream_id", self.last.view.motion_id)
        reference = StreamedPose(stream_id, number, self.now_ns, pose, **more)
        now_ns = self.now_ns + round(1e9 * self.settings.cycle_s)  # it comes right before the next scan
        return self.step(arrival=StreamedPoseReceived(reference, now_ns, now_ns - round(1e9 * age_s))).refusal

    def moving(self) -> "Bench":
        """This bench, in the middle of a motion of 0.3 m."""
        self.enabled()
        assert self.refer(self.shifted(z=0.3)).reason is Reason.ACCEPTED
        self.run(1.0)
        return self

    def _exchange(self) -> SensorImage:
        status = self.status
        if self.outputs:
            valves = self.last.valves
            if valves.control & CONTROL_RESET_WATCHDOG and self.hears_reset:
                self.status &= ~STATUS_WATCHDOG_TRIPPED
            if not self.deaf:
                self.echo = valves.controller_cycle
            if valves.control & CONTROL_ENABLE:
                status |= STATUS_VALVES_ENABLED if self.enables else 0
                if not self.stuck:
                    self.q = self.last.view.q_cmd
        self.plant_cycle += 0 if self.frozen else 1
        pressures = ((60.0, 60.0),) * 6
        standing = tuple(map(sum, zip(self.q, self.offset, strict=True)))
        return SensorImage(
            self.plant_cycle, self.echo, status, counts(standing), pressures, self.supply_bar, 10.0, 40.0
        )
