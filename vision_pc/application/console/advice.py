"""What to do about a cause: one sentence for the person who has to."""

import itertools
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nominal_arm.dimensions import DhLink
from vision_pc.core.se3 import Array


def skeleton(links: tuple[DhLink, ...], q: tuple[float, ...]) -> Array:
    """Points (n + 1, 3) in B, m: the base's origin, then that of each link's frame; the last is the TCP.

    ``q`` (rad) are the joints; links beyond them stand still. Each link is Rz(θ) Tz(d) Tx(a) Rx(α)
    (Mäkinen et al. 2023, Table 1).
    """
    X = np.eye(4)
    points = [X[:3, 3].copy()]
    for index, link in enumerate(links):
        X = X @ _link(link, q[index] if index < len(q) else 0.0)
        points.append(X[:3, 3].copy())
    return np.array(points)


def _link(link: DhLink, q: float) -> Array:
    theta = q + link.theta_offset
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(link.alpha), np.sin(link.alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, link.a * c],
            [s, c * ca, -c * sa, link.a * s],
            [0.0, sa, ca, link.d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


_MOVING_S = 0.5
_AT_REST_S = 2.5  # somebody may still walk into the picture
_MOVED_RAD = 2e-3  # a joint: more than valves leak in a second


class MeasuringPace:
    """Twice a second while the arm moves, seldom at rest, where nothing changes that joints tell of."""

    def __init__(self) -> None:
        self._last_s = -np.inf
        self._joints_rad: NDArray[np.float64] | None = None

    def due(self, now_s: float, joints_rad: NDArray[np.float64] | None) -> bool:
        """Whether to measure now; if so, that counts as done. ``joints_rad`` (n,) is None while unknown."""
        rests = (
            joints_rad is not None
            and self._joints_rad is not None
            and bool(np.all(np.abs(joints_rad - self._joints_rad) < _MOVED_RAD))
        )
        if now_s - self._last_s < (_AT_REST_S if rests else _MOVING_S):
            return False
        self._last_s, self._joints_rad = now_s, joints_rad
        return True


_OF_CAUSE = {
    "fault.plant_link_lost": "Look after the fieldbus and the plant; then reset and enable.",
    "fault.plant_cycle_frozen": "The plant stands still: start it anew, then reset and enable.",
    "fault.reference_link_lost": "The link broke in motion. Reset and enable; repeat what was interrupted.",
    "fault.following_error": "Look for what blocks the joint, for load and oil; then reset and enable.",
    "fault.encoder_jump": "Check the encoder and its cable before you reset.",
    "fault.encoder_stuck": "Check the encoder, the valve and the oil supply before you reset.",
    "fault.joint_limit": "Reset and enable, then jog back into the range.",
    "fault.workspace_limit": "Reset and enable, then jog back into the workspace.",
    "fault.overspeed": "Ask for a longer time or a smaller step; then reset and enable.",
    "fault.supply_pressure_lost": "Start the pump and wait for pressure; then reset and enable.",
    "fault.plant_watchdog": "The plant closed its valves by itself: find out why, then reset and enable.",
    "fault.emergency_stop": "Make sure that all is safe; release, reset, enable.",
    "fault.numeric": "Tell the developers, with the record of this run. Reset and enable.",
    "fault.overrun": "Close other work on the controller's machine; then reset and enable.",
    "fault.plant_status": "Look at the plant's own status; mend it, then reset and enable.",
    "fault.reference_stale": "The vision PC was too slow: close other work; then reset and enable.",
    "link.plant_silent": "The controller does not hear the plant: look after the fieldbus and the plant.",
    "link.camera_missing": "Is the camera connected, or the emulator running?",
    "link.camera_silent": "No picture comes: check the camera and its cable. Nothing is measured meanwhile.",
    "link.camera_frozen": "The same picture comes again and again: start the camera anew.",
    "link.wrong_arm": "Vision and controller have different arm.yaml files: give both the same.",
    "link.session_occupied": "Another client holds the controller: end it, or wait.",
    "machine.begun_anew": "Reset, enable, turn parallel, calibrate; click the targets again.",
    "machine.overloaded": "Close other work on this machine.",
    "machine.no_real_time": "Keep the machine free of other work, or allow the services the real-time class.",
    "service.crashed": "Read the service's log for what it did last; then reset and enable.",
    "recording.unwritable": "Events cannot be recorded: look after the disk.",
    "refused.asked_too_late": "The network held it up. Look at the machine, then ask once more.",
    "request.bad_header": "Send the time of a snapshot of GET /events, or leave the header out.",
    "refused.busy": "Wait for the operation that runs, or cancel it.",
    "refused.disabled": "Hold ENABLE first.",
    "refused.moving": "Wait until the arm rests, or stop it.",
    "refused.not_calibrated": "Run the calibration step first.",
    "refused.unreachable": "Choose a target within the arm's reach, or turn the tool.",
    "refused.joint_limit": "Go in smaller steps, or turn the tool.",
    "refused.outside_workspace": "Choose a target inside the workspace.",
    "refused.stopped": "Somebody stopped it. Repeat the step when you are ready.",
    "refused.role": "You may look and stop. To move the arm, sign in with the operator's token.",
    "refused.emergency_latched": "Make sure that all is safe; release, reset, enable.",
    "refused.error_latched": "See the alarm for its cause; then reset and enable.",
    "refused.no_trials": "Start the controller anew, with controller.excitation.enabled=true.",
    "refused.stopping": "Wait until the arm rests, then repeat.",
    "refused.target_lost": "Click it again, or forget it.",
    "refused.unknown_target": "Click a place in the picture first.",
    "measurement.object_not_seen": "Bring the object's markers into the left eye's picture, well lit;"
    " without markers, click a target in it.",
    "measurement.tool_not_seen": "Bring the tool's marker into the left eye's picture, well lit.",
    "measurement.marker_lost": "Begin where tool and object stay in the left eye's picture all the way.",
    "measurement.view_lost": "Keep the view of tool and object free; then repeat the step.",
    "measurement.object_inside_circle": "Use a smaller circle, or begin further away.",
    "measurement.calibration_stale": "The arm was moved or turned since: repeat the local calibration.",
    "measurement.ill_conditioned": "Repeat the local calibration here, with longer segments.",
    "measurement.match_poor": "Repeat the local calibration with longer segments.",
    "measurement.match_lost": "Repeat the local calibration, with the view free and the scene lit.",
    "measurement.not_associated": "Tell the developers, with the record of this run.",
    "measurement.path_closed": "Let the path of calibration end away from where it began.",
    "measurement.path_straight": "Let the path of calibration turn: segments along several axes.",
    "measurement.path_symmetric": "Let the segments of the path of calibration differ in length.",
    "measurement.path_too_short": "Let the path of calibration be longer.",
    "measurement.too_few_samples": "Drive slower or further, so that more pictures are taken on the way.",
    "measurement.step_too_large": "Jog nearer, then repeat the step.",
    "measurement.turn_too_large": "Turn the tool nearer to the target by jogging, then repeat the step.",
    "measurement.not_settled": "The arm did not come to rest: look for what shakes it, then repeat the step.",
    "measurement.play_too_wide": "The joints have too much play for that: use another method.",
    "measurement.play_unseen": "Keep the view free and the scene lit; then repeat.",
    "measurement.odometry_lost": "Too little texture, or too fast: light the scene, keep the view free.",
    "measurement.camera_frozen": "The same picture comes again and again: start the camera anew.",
    "measurement.camera_off_calibration": "Calibrate the camera anew (longreach camera calibrate).",
    "measurement.camera_silent": "No picture comes: check the camera and its cable.",
    "measurement.no_frames": "No picture comes: check the camera and its cable.",
    "measurement.no_picture": "No picture comes: check the camera and its cable.",
    "measurement.hand_eye.cabinet_not_seen": "Bring the cabinet's marker into the left picture, well lit.",
    "measurement.hand_eye.corner_noise": "Take the samples of largest residual again, or leave them out.",
    "measurement.hand_eye.exchanged": "Exchange the two lists of poses, or invert one of them.",
    "measurement.hand_eye.few_samples": "Take more samples.",
    "measurement.hand_eye.left_handed": "Mirrored poses: check the axes of the file.",
    "measurement.hand_eye.marker_not_seen": "Hang the session's marker into the left eye's picture, well lit;"
    " of the emulated worlds hand_eye has one.",
    "measurement.hand_eye.motions_differ": "Check the samples' order, and that the marker stands still.",
    "measurement.hand_eye.no_consensus": "Take the samples again, the arm at rest; check the marker's size.",
    "measurement.hand_eye.no_corners": "Choose another solver: these samples have no corners.",
    "measurement.hand_eye.no_pose": "Begin where the arm may turn further, the marker in the middle.",
    "measurement.hand_eye.no_solution": "Take more samples that turn about different axes.",
    "measurement.hand_eye.noise": "Take the samples of largest residual again, or leave them out.",
    "measurement.hand_eye.not_settled": "The arm still swings: wait, then sample again.",
    "measurement.hand_eye.parallel_axes": "Take samples that turn about another axis too.",
    "measurement.hand_eye.scale": "Check the printed size of marker or board, and the unit of the poses.",
    "measurement.hand_eye.sdp": "Choose another solver, such as robust.",
    "measurement.hand_eye.singular": "Take more samples that turn about different axes.",
    "measurement.hand_eye.target_not_seen": "Bring the target into the left eye's picture, well lit.",
    "measurement.hand_eye.too_few_samples": "Take more samples.",
    "measurement.hand_eye.too_little_rotation": "Take samples that turn further.",
    "measurement.hand_eye.wrong_marker": "Hang the session's own marker, or begin one for this.",
    "refused.hand_eye.complete": "All samples are taken: solve.",
    "refused.hand_eye.no_proposal": "Drive to the next pose first.",
    "refused.hand_eye.no_sample": "Take that sample first.",
    "refused.hand_eye.no_session": "Begin or resume a session first.",
    "refused.hand_eye.none": "This service has no hand-eye calibration: start it with one.",
    "refused.hand_eye.not_solved": "Solve first.",
    "target.ambiguous": "Click something that is there once, or the same place in the other eye too.",
    "target.contradicted": "Look again where it is in the other eye, or click beside what repeats itself.",
    "target.depth_edge": "Click beside the step.",
    "target.frame_too_old": "Click in the live picture, with the arm at rest.",
    "target.hidden": "Click beside the tool, or jog until the tool is beside the place.",
    "target.low_texture": "Click where there is something to see, or light it better.",
    "target.moves": "Click what stands still, or wait until it does.",
    "target.no_hole": "Click inside the rim of a hole, seen whole.",
    "target.no_match": "Click a place that both eyes see.",
    "target.not_found": "Look whether it is in the picture; else click it again.",
    "target.not_planar": "Click a flat place that faces the camera.",
    "target.not_round": "Click a hole whose rim is seen all around, or a surface beside it.",
    "target.outside_picture": "Click further from the rim, or jog until the place is in the middle.",
    "target.wrong_size": "Click a hole of the size that is drilled, or set the diameters that are wanted.",
    "motion.not_settled": "The arm still swings: wait, then repeat the step.",
}
_OF_AREA = {
    "fault": "Find the cause; then reset and enable.",
    "link": "Is the other side running, and reachable? The page goes on by itself when it is.",
    "measurement": "Check light, view and markers; then repeat the step.",
    "target": "Click another place.",
    "refused": "Nothing was moved. Change what is said, then repeat.",
    "recording": "Look after the disk.",
    "motion": "Wait until the arm rests, then repeat the step.",
}
_ELSE = "See the event log of the vision PC."


def advice(cause: str) -> str:
    """What to do about ``cause``; of a cause without a sentence of its own, that of its area."""
    return _OF_CAUSE.get(cause) or _OF_AREA.get(cause.partition(".")[0], _ELSE)


URGENT, HIGH, LOW = 1, 2, 3  # at once; soon; when there is time
_KEPT = 100


class Condition(NamedTuple):
    """Something that is wrong at present. ``priority``: URGENT, HIGH or LOW."""

    priority: int
    detail: str


class Alarm(NamedTuple):
    """One alarm. Times are seconds since 1970; ``ended_s`` is None while it lasts."""

    number: int
    cause: str
    priority: int
    detail: str
    began_s: float
    ended_s: float | None


class AlarmList:
    """The newest alarms, active and ended, bounded in number."""

    def __init__(self) -> None:
        self._active: dict[str, Alarm] = {}
        self._ended: deque[Alarm] = deque(maxlen=_KEPT)
        self._numbers = itertools.count(1)

    def update(self, now_s: float, conditions: Mapping[str, Condition]) -> None:
        """Take note of all that is wrong at ``now_s``, by cause; what is missing has ended."""
        for cause in [cause for cause in self._active if cause not in conditions]:
            self._ended.appendleft(self._active.pop(cause)._replace(ended_s=now_s))
        for cause, (priority, detail) in conditions.items():
            known = self._active.get(cause)
            if known is None:
                number = next(self._numbers)
                self._active[cause] = Alarm(number, cause, priority, detail, now_s, None)
            else:
                self._active[cause] = known._replace(priority=priority, detail=detail)

    def happened(self, now_s: float, cause: str, detail: str, priority: int = LOW) -> None:
        """Take note of what was over as soon as it had happened, such as an operation that failed."""
        self._ended.appendleft(Alarm(next(self._numbers), cause, priority, detail, now_s, now_s))

    @property
    def rows(self) -> list[Alarm]:
        """The active ones, the most urgent and then the newest first; then those that ended, newest first."""
        active = sorted(self._active.values(), key=lambda alarm: (alarm.priority, -alarm.number))
        return [*active, *self._ended]


def alarm_json(alarm: Alarm) -> dict[str, Any]:
    """An alarm with what to do about it."""
    return {
        "number": alarm.number,
        "cause": alarm.cause,
        "priority": alarm.priority,
        "detail": alarm.detail,
        "advice": advice(alarm.cause),
        "began_at": alarm.began_s,
        "ended_at": alarm.ended_s,
    }
