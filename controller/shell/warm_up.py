"""A short life of a controller that is thrown away, so that every kernel is compiled before time counts."""

from controller.core.scan import scan
from controller.core.scan_types import ScanInput, initial_state
from controller.core.settings import ScanSettings
from protocol.faults import CommandCode
from protocol.pose import Pose
from protocol.process_image import COUNTS_PER_TURN, STATUS_SUPPLY_ON, STATUS_VALVES_ENABLED, SensorImage
from protocol.reference_messages import Command, ReferencePath, ReferencePose, Request, StreamedPose
from protocol.session_events import StreamedPoseReceived

_POSE_DEG = (0.0, 50.0, -75.0, 0.0, -25.0, 0.0)


def warm_up(settings: ScanSettings) -> None:
    """Enable, follow streamed references, move, re-plan, stop."""
    state = initial_state(settings)
    a, b, c, d, e, f = (round(angle / 360.0 * COUNTS_PER_TURN) for angle in _POSE_DEG)
    for cycle in range(10):
        here = state.tool
        x, y, z = here.p_BT.tolist()
        w, i, j, k = here.quaternion.tolist()
        goal = ReferencePose(cycle, Pose((x, y, z + 0.01 * cycle), (w, i, j, k)), 0.0)
        script: dict[int, Request] = {
            1: Command(cycle, CommandCode.ENABLE),
            2: Command(cycle, CommandCode.START_STREAM),
            5: Command(cycle, CommandCode.END_STREAM),
            6: goal,
            7: ReferencePath(cycle, (goal.X_BT_ref,), 3.0, 0.0),
            8: Command(cycle, CommandCode.STOP),
        }
        streamed = StreamedPoseReceived(StreamedPose(2, cycle, 0, goal.X_BT_ref), 0, 0)
        requests = (script[cycle],) if cycle in script else ()
        status = STATUS_SUPPLY_ON | STATUS_VALVES_ENABLED
        image = SensorImage(
            cycle, state.cycle, status, (a, b, c, d, e, f), ((50.0, 50.0),) * 6, 190.0, 10.0, 40.0
        )
        state, _ = scan(settings, state, ScanInput(0, 0, settings.cycle_s, image, requests, True, streamed))
