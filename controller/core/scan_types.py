"""What goes into a scan, what it keeps, and what comes out."""

from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import Joints, joints_in_motion
from controller.core.plant_watch import PlantRefusal, PlantWatch, unseen
from controller.core.references.streaming import OpenStream
from controller.core.servo.joint_control import JointFilters, unmoved
from controller.core.servo.servo_step import ToolState, tool_state
from controller.core.servo.settling import MOVING, Settling
from controller.core.settings import ScanSettings
from controller.core.supervision import RESTED, Fault, ServoOutput, Timers
from controller.core.trajectories.motion import DesiredMotion, holding
from protocol.axes_group import Mode
from protocol.faults import FaultCode, GroupState, Severity
from protocol.pose import Pose
from protocol.process_image import SensorImage, ValveImage
from protocol.reference_messages import Acknowledgement, Request, State, StreamRefused
from protocol.session_events import StreamedPoseReceived

Sextuple = tuple[float, float, float, float, float, float]
NO_FAULT = Fault(FaultCode.NONE, 0.0, 0.0)


class ScanInput(NamedTuple):
    """One scan's input image. ``dt_s``: since the scan before. ``sensors``: None when the exchange failed.

    ``sensed_ns``: when the sensors were read, before ``now_ns``, when requests are judged. ``streamed``: the
    newest streamed reference that came since the scan before.
    """

    now_ns: int
    sensed_ns: int
    dt_s: float
    sensors: SensorImage | PlantRefusal | None
    requests: tuple[Request, ...]
    reference_link_alive: bool
    streamed: StreamedPoseReceived | None = None


class ScanEvent(NamedTuple):
    """Something worth a line in a log: a name, a cause in words, and the number behind it with its limit
    (SI)."""

    name: str
    cause: str
    value: float
    limit: float


class ControllerView(NamedTuple):
    """The controller's own view of the arm: what a State message says, as far as the core knows it."""

    time_ns: int
    cycle: int
    group_state: GroupState
    fault: FaultCode
    severity: Severity
    flags: int
    motion_id: int
    motion_done: bool
    segment: int
    q_meas: Sextuple
    q_cmd: Sextuple
    valves: Sextuple
    X_BT: Pose
    X_BT_cmd: Pose
    supply_bar: float
    plant_exchange_failures: int
    stream_number: int


class RuntimeStatistics(NamedTuple):
    """What a State message says beyond the core's own view: the cycle's lateness (µs) and the link's
    losses."""

    overruns: int
    lateness_p50_us: int
    lateness_p99_us: int
    lateness_max_us: int
    references_lost: int
    references_dropped: int


def to_state(view: ControllerView, statistics: RuntimeStatistics) -> State:
    """The State message of ``view`` and ``statistics``."""
    return State(**view._asdict(), **statistics._asdict())


class ScanOutput(NamedTuple):
    """One scan's output image. ``refusal``: of the streamed reference, None when it is followed."""

    valves: ValveImage
    acknowledgements: tuple[Acknowledgement, ...]
    refusal: StreamRefused | None
    view: ControllerView
    events: tuple[ScanEvent, ...]


class ScanState(NamedTuple):
    """What a scan leaves to the next. Arrays are never written to.

    ``fault``: the first one since the last reset. ``settled_s``: how long the arm has stood
    still inside the tolerance. ``stream``: the open one, None in every mode but STREAMING. ``fade``: see
    ``update_fade``.
    ``rearming``: scans in a row in which the plant's watchdog was asked to be re-armed. ``parking``: see
    ``parking.joint``; ``settling``: how far the joints have come to rest;
    ``settled_at``: the tool's place p_BT (3,), m, when the arm settled.
    """

    cycle: int
    mode: Mode
    fault: Fault
    severity: Severity
    watch: PlantWatch
    timers: Timers
    tool: ToolState
    motion: DesiredMotion
    servo: ServoOutput
    filters: JointFilters
    settled_s: float
    stream: OpenStream | None
    fade: float
    rearming: int
    parking: Joints
    settling: Settling
    settled_at: Array


def idle(q_meas: Array) -> ServoOutput:
    """Valves centred, the command on the measurement: nothing jumps when the group is enabled."""
    zero = np.zeros(6)
    return ServoOutput(q_meas, zero, zero, np.zeros(3))


def initial_state(settings: ScanSettings) -> ScanState:
    """The state before the first scan: disabled, nothing known of the plant."""
    watch = unseen()
    tool = tool_state(settings.table, watch.q_meas)
    return ScanState(
        cycle=0,
        mode=Mode.DISABLED,
        fault=NO_FAULT,
        severity=Severity.NONE,
        watch=watch,
        timers=RESTED,
        tool=tool,
        motion=holding(tool.p_BT, tool.quaternion),
        servo=idle(watch.q_meas),
        filters=unmoved(np.zeros(6), np.zeros(6)),
        settled_s=0.0,
        stream=None,
        fade=0.0,
        rearming=0,
        parking=joints_in_motion(),
        settling=MOVING,
        settled_at=tool.p_BT,
    )
