"""An arm and eyes that answer as they did in a recording, and have what they are asked for compared with it.

Nothing waits: every answer is there at once. What of the rest of the application a program asks for was not
recorded, and says so.
"""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any, Protocol

import numpy as np

from protocol.faults import CommandCode
from protocol.reference_messages import Command, ReferencePath, ReferencePose, Request, StreamedPose
from testbed.recordings.recorded_vision import AnsweredCall, RecordedOperations
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array, to_pose
from vision_pc.core.types import Look, WatchHealth, WatchSample
from vision_pc.shell.recording import read_messages as reads

UNTIMED = -1
"""The time of a streamed reference that rests on no picture: whenever it is sent."""


class LeavesReplay(BaseException):
    """The program asks for what it did not ask for then: it cannot go on. No error that programs handle."""


class NotRecorded(LeavesReplay):
    """The program asks for what is not recorded."""


class AnswerSource(Protocol):
    """Where the recorded answers come from; it compares the references that are sent for each."""

    def take(self, call: str, *sent: Request | StreamedPose) -> AnsweredCall:
        """The answer to ``call``, which sends ``sent``.

        Raises what was raised then, LeavesReplay where something else was asked for then.
        """
        ...


class ReplayedArm:
    """Implements ``vision_pc.application.ports.StoppableArm``."""

    def __init__(self, answers: AnswerSource) -> None:
        self._answers = answers

    async def view(self) -> ArmView:
        """The view that was given."""
        return reads.view_of_message(self._answers.take("arm.view").message)

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        """The view after that motion."""
        sent = ReferencePose(0, to_pose(X_BT_ref), duration_s)
        return reads.view_of_message(self._answers.take("arm.move_to", sent).message)

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        """The view after that motion."""
        sent = ReferencePath(0, tuple(to_pose(X) for X in waypoints), segment_s, dwell_s)
        return reads.view_of_message(self._answers.take("arm.follow", sent).message)

    @asynccontextmanager
    async def streaming(self) -> AsyncIterator["ReplayedStream"]:
        """The stream that was opened."""
        begun = self._answers.take("stream.begin", Command(0, CommandCode.START_STREAM))
        opened = [sent.message.number for sent in begun.references if sent.message.command == "START_STREAM"]
        try:
            yield ReplayedStream(self._answers, opened[-1] if opened else 0)
        except LeavesReplay:
            raise
        except BaseException:
            self._answers.take("stream.broken", Command(0, CommandCode.STOP))
            raise
        self._answers.take("stream.end", Command(0, CommandCode.END_STREAM))

    async def stop(self) -> None:
        """As it was."""
        self._answers.take("arm.stop", Command(0, CommandCode.STOP))

    async def halt(self) -> None:
        """As it was."""
        self._answers.take("arm.halt", Command(0, CommandCode.STOP))


class ReplayedStream:
    """Implements ``vision_pc.core.ports.ReferenceStream``."""

    def __init__(self, answers: AnswerSource, stream_id: int) -> None:
        self._answers = answers
        self._stream_id = stream_id
        self._sent = 0

    async def send(
        self, X_BT_ref: Array, measured_ns: int | None = None, twist_ref: Array | None = None
    ) -> None:
        """As it was."""
        self._sent += 1
        a, b, c, d, e, f = (np.zeros(6) if twist_ref is None else np.asarray(twist_ref, dtype=float)).tolist()
        time_ns = UNTIMED if measured_ns is None else measured_ns
        sent = StreamedPose(self._stream_id, self._sent, time_ns, to_pose(X_BT_ref), (a, b, c, d, e, f))
        self._answers.take("stream.send", sent)

    async def view(self) -> ArmView:
        """The view that was given."""
        return reads.view_of_message(self._answers.take("stream.view").message)


class ReplayedEyes:
    """Implements ``vision_pc.core.ports.Eyes``."""

    def __init__(self, answers: AnswerSource, operations: RecordedOperations) -> None:
        self._answers = answers
        self._operations = operations

    async def look(self, frames: int | None = None) -> Look:
        """The look that was taken."""
        number: int = self._answers.take("eyes.look").message.look
        return self._operations.looks[number - 1]

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator["ReplayedWatch"]:
        """The watch that was kept."""
        number = self._answers.take("watch.begin").message.watch
        try:
            yield ReplayedWatch(self._answers, self._operations, number)
        except LeavesReplay:
            raise
        except BaseException:
            self._answers.take("watch.broken")
            raise
        self._answers.take("watch.end")


class ReplayedWatch:
    """Implements ``vision_pc.core.ports.Watch``, of watch ``number``."""

    def __init__(self, answers: AnswerSource, operations: RecordedOperations, number: int) -> None:
        self._answers = answers
        self._operations = operations
        self._number = number

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        """As many as there were then."""
        return self._watch_samples(self._answers.take("watch.samples").message.samples)

    @property
    def health(self) -> WatchHealth:
        """As it was then."""
        return reads.health_of_message(self._answers.take("watch.health").message)

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        """What was given then."""
        said = self._answers.take("watch.after").message
        return self._watch_samples(said.samples)[-1] if said.HasField("samples") else None

    def _watch_samples(self, count: int) -> tuple[WatchSample, ...]:
        return tuple(self._operations.samples.get(self._number, ())[:count])


class Unrecorded:
    """A part of the application of which nothing is recorded; whoever asks it for anything is told so."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, asked: str) -> Any:
        raise NotRecorded(f"{self._name}.{asked}")


class ReplayedController(Unrecorded):
    """The controller, of which programs that only look want to know whether it is there."""

    connected = True


class ReplayedTargets(Unrecorded):
    """Targets: aiming at one changes what the eyes see, which is recorded; what is known of it is not."""

    def aim(self, target_id: str) -> None:
        """Do nothing."""


class ReplayedCamera(Unrecorded):
    """The camera: whether it carried targets shows in what was asked of the eyes next."""

    def __init__(self, operations: RecordedOperations) -> None:
        super().__init__("camera")
        self._operations = operations
        self.targets = ReplayedTargets("camera.targets")

    @property
    def carries(self) -> bool:
        """Whether a motion was watched for the sake of targets."""
        ahead = self._operations.peek()
        return ahead is not None and ahead.message.call == "watch.begin"


class SilentLog:
    """A log that nobody reads."""

    healthy = True

    def write(self, event: str, level: str = "info", /, **fields: Any) -> None:
        """Do nothing."""
