"""How a guided session drives: to a pose, or back to its start when it has got stuck in a corner.

A refusal of the controller moves nothing. Which of them says that a pose cannot be reached: ``impossible``.
"""

from protocol.errors import RequestRefused
from vision_pc.core.hand_eye.guided.session import Session
from vision_pc.core.ports import Arm, ArmView

_IMPOSSIBLE = {
    f"refused.{reason}"
    for reason in (
        "outside_workspace", "joint_limit", "unreachable", "singular", "too_fast", "too_far",
        "fault_joint_limit", "fault_workspace_limit", "fault_following_error",
    )
}  # fmt: skip


def impossible(error: RequestRefused) -> bool:
    """Whether the pose is not to be tried again: it was refused for its way, or the way ended in a fault."""
    return error.cause in _IMPOSSIBLE


def ended_in_fault(error: RequestRefused) -> bool:
    """Whether the arm has come to rest by a fault, and moves again only after RESET and ENABLE."""
    return error.cause.startswith("refused.fault_")


async def back_to_start(arm: Arm, session: Session) -> ArmView:
    """The view at the session's starting pose: straight there, or over its samples, the newest first.

    What led to a sample leads back from it, where the straight way would turn the wrist through its limits.
    Raises RequestRefused with what the controller said last.
    """
    start = session.around.X_BT_start
    for sample in (None, *reversed(session.samples)):
        try:
            if sample is not None:
                await arm.move_to(sample.X_BT)
            return await arm.move_to(start)
        except RequestRefused as error:
            if not impossible(error) or ended_in_fault(error):
                raise
            refusal = error
    raise refusal
