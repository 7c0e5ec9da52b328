"""Whether the machine behind the link has begun anew, by its plant and its camera."""

from collections.abc import Callable

from protocol.reference_messages import FLAG_PLANT_LINK_OK
from protocol.session_events import ClientEvent, SessionLost, StateReceived
from vision_pc.application.ports import FrameSource
from vision_pc.application.reference_link import ReferenceLink, Streamed, Submitted
from vision_pc.core.types import StereoPair


class MachineWatch:
    """Calls ``begun_anew`` when the plant was silent and the camera counts its pictures from the start again.

    Either alone is no reason: a camera that is plugged in anew stands where it stood, and what the arm did
    while its fieldbus was interrupted, the encoders tell.
    """

    def __init__(
        self, frames: FrameSource[StereoPair], link: ReferenceLink, begun_anew: Callable[[], None]
    ) -> None:
        self._frames = frames
        self._link = link
        self._begun_anew = begun_anew
        self._silent = False  # the plant was, and no picture of the same row has come since
        self._counts_anew = False
        self._answers_ns = 0
        self._last: StereoPair | None = None
        link.listeners.append(self._on_heard)

    def _on_heard(self, event: Submitted | Streamed | ClientEvent) -> None:
        if isinstance(event, SessionLost):
            self._silent, self._answers_ns = True, 0
        elif isinstance(event, StateReceived):
            self._judge(bool(event.state.flags & FLAG_PLANT_LINK_OK))

    def _judge(self, answers: bool) -> None:
        if not answers:
            self._silent, self._answers_ns = True, 0
        elif not self._answers_ns:
            self._answers_ns = self._link.now_ns
        newest, last = self._frames.newest, self._last
        if newest is not None and newest is not last:
            self._counts_anew |= last is not None and newest.frame_id < last.frame_id
            self._last = newest
        if not answers:
            return
        if self._silent and self._counts_anew:
            self._silent = False
            self._begun_anew()
        elif newest is not None and newest.capture_ns > self._answers_ns:
            self._silent = False  # the camera's own row of pictures has gone on
        if not self._silent:
            self._counts_anew = False
