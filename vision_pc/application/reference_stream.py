"""An open stream of references over the reference link, and the arm's view that programs get from it."""

import numpy as np

from protocol.errors import RequestRefused
from protocol.faults import GroupState
from protocol.reference_messages import FLAG_SETTLED, FLAG_STREAMING, State, StreamedPose
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array, from_pose, to_pose

_NUMBERS = 1 << 32


class ArmStream:
    """Implements ``vision_pc.core.ports.ReferenceStream``; nothing here waits."""

    def __init__(self, link: ReferenceLink, stream_id: int) -> None:
        self.stream_id = stream_id
        self._link = link
        self._sent = 0
        self._begun = False

    async def send(
        self, X_BT_ref: Array, measured_ns: int | None = None, twist_ref: Array | None = None
    ) -> None:
        """Send one reference. Raises as the port says."""
        self.check()
        self._sent = (self._sent + 1) % _NUMBERS
        twist = np.zeros(6) if twist_ref is None else np.asarray(twist_ref, dtype=float)
        a, b, c, d, e, f = twist.tolist()
        time_ns = self._link.now_ns if measured_ns is None else measured_ns
        self._link.stream(
            StreamedPose(self.stream_id, self._sent, time_ns, to_pose(X_BT_ref), (a, b, c, d, e, f))
        )

    async def view(self) -> ArmView:
        """The newest view. Raises as the port says."""
        self.check()
        return view_of(self._link.state, self._link)

    def check(self) -> None:
        """Raise RequestRefused when the stream is closed or one of its references was refused.

        A state that does not name the stream's motion was under way when the stream was opened.
        """
        refused = self._link.refusal_of(self.stream_id)
        state = self._link.state
        self._begun |= state.motion_id == self.stream_id
        if self._begun:
            refuse_broken(state)
            if not state.flags & FLAG_STREAMING or state.motion_id != self.stream_id:
                raise RequestRefused("refused.not_streaming", "the controller has ended the stream")
        if refused is not None:
            what = f"streamed reference {refused.number}"
            raise self._link.refused(what, refused.reason, refused.value, refused.limit)


def refuse_broken(state: State) -> None:
    """Raises RequestRefused when the group is not in a state in which a motion goes on."""
    if state.group_state is GroupState.ERROR_STOP:
        fault = state.fault.name.lower()
        raise RequestRefused(
            f"refused.fault_{fault}", f"the motion ended by a fault: {fault.replace('_', ' ')}"
        )
    if state.group_state is GroupState.DISABLED:
        raise RequestRefused("refused.disabled", "the arm is disabled")
    if state.group_state is GroupState.STOPPING:
        raise RequestRefused("refused.stopped", "the motion was stopped")


def view_of(state: State, link: ReferenceLink) -> ArmView:
    """A state of the link as programs see it, on our clock."""
    return ArmView(
        time_ns=link.local_time_ns(state.time_ns),
        group_state=state.group_state,
        fault=state.fault,
        severity=state.severity,
        motion_id=state.motion_id,
        motion_done=state.motion_done,
        settled=bool(state.flags & FLAG_SETTLED),
        q_meas=np.array(state.q_meas),
        q_cmd=np.array(state.q_cmd),
        X_BT=from_pose(state.X_BT),
        X_BT_cmd=from_pose(state.X_BT_cmd),
    )
