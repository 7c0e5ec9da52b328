"""Diagnostics of the arm and of refusals, and how an action ends, as plain data."""

from typing import NamedTuple

from protocol.errors import LinkLost, LongreachError
from protocol.faults import GroupState
from protocol.reference_messages import FLAG_PLANT_LINK_OK, FLAG_SETTLED, State
from vision_pc.application.reference_link import ReferenceLink

OK, WARN, ERROR, STALE = range(4)
# of control_msgs/FollowJointTrajectory
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, OLD_STAMP, OFF_PATH, OFF_GOAL = 0, -1, -2, -3, -4, -5
_CODES = {
    "refused.ros_joints": INVALID_JOINTS,
    "refused.ros_stamp": OLD_STAMP,
    "refused.ros_path_tolerance": OFF_PATH,
    "refused.ros_goal_tolerance": OFF_GOAL,
    "motion.not_settled": OFF_GOAL,
}


class Diagnosis(NamedTuple):
    """``level`` as in DiagnosticStatus, ``message`` in words, ``values`` by their keys."""

    level: int
    message: str
    values: dict[str, str]


class Refusals:
    """The newest refusal of what came by a topic, which has no answer of its own."""

    def __init__(self) -> None:
        self.newest: dict[str, str] = {}
        self.count = 0

    def note(self, topic: str, error: LongreachError) -> None:
        """Keep ``error`` as the newest."""
        self.count += 1
        self.newest = {"refused_topic": topic, "refused_cause": error.cause, "refused": str(error)}


def diagnosis(link: ReferenceLink, refusals: Refusals) -> Diagnosis:
    """What the arm's newest state and the newest refusal say; never raises."""
    refused = {**refusals.newest, "refusals": str(refusals.count)}
    try:
        state = link.state
    except LinkLost as error:
        return Diagnosis(STALE, str(error), {"cause": error.cause, **refused})
    level, message = _judged(state)
    values = {
        "group_state": state.group_state.name,
        "fault": state.fault.name,
        "severity": state.severity.name,
        "settled": str(bool(state.flags & FLAG_SETTLED)).lower(),
        "motion": str(state.motion_id),
        "motion_done": str(bool(state.motion_done)).lower(),
        "supply_bar": f"{state.supply_bar:.1f}",
        "state_age_ms": f"{link.state_age_ns / 1e6:.1f}",
        "overruns": str(state.overruns),
        "plant_exchange_failures": str(state.plant_exchange_failures),
    }
    return Diagnosis(level, message, values | refused)


def news_of(state: State) -> tuple[int, ...]:
    """What of a state is published at once when it changes: the arm's condition, its motion, its rest."""
    flags = state.flags & (FLAG_SETTLED | FLAG_PLANT_LINK_OK)
    return state.group_state, state.fault, state.motion_id, state.motion_done, flags


def _judged(state: State) -> tuple[int, str]:
    if state.group_state is GroupState.ERROR_STOP:
        return ERROR, f"stopped by {state.fault.name.lower().replace('_', ' ')}: reset, then enable"
    if not state.flags & FLAG_PLANT_LINK_OK:
        return ERROR, "the controller does not hear the plant"
    if state.group_state is GroupState.DISABLED:
        return WARN, "disabled"
    return OK, state.group_state.name.lower()


class GoalOutcome(NamedTuple):
    """``code`` as in the action's result, ``text`` for its error_string; ``cancelled`` by the client."""

    code: int
    text: str
    cancelled: bool = False


def code_of(cause: str) -> int:
    """The action's code for a refusal of ours or of the controller; else INVALID_GOAL."""
    return _CODES.get(cause, INVALID_GOAL)
