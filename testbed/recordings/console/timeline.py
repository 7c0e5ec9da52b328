"""What vision and controller recorded, along vision's clock: what was the newest of each at any time."""

from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

from controller.shell.scan_recorder import STATE, StateMessage, state_of_message
from foundation.recording.messages import fields_of
from foundation.recording.reading import Damage, RecordingUnreadable, messages
from protocol.reference_messages import State
from testbed.recordings.merging import fitted_clock
from testbed.recordings.pixels import RecordedStamp
from testbed.recordings.recorded_vision import RecordedVision, metadata_of
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_recorder as topics

_TOPICS = (
    topics.FRAME, topics.OBSERVATION, topics.LOOK, topics.EVENT, topics.CLOCK, *topics.IMAGES
)  # fmt: skip
_STATE_EVERY_NS = 50_000_000  # [D] twice what a console is told, and what an hour of takes 40 MB
T = TypeVar("T")


class Series(Generic[T]):
    """Things in the order of their times (ns, vision's clock)."""

    def __init__(self) -> None:
        self.times_ns: list[int] = []
        self.items: list[T] = []

    def add(self, time_ns: int, item: T) -> None:
        """Add one that is not older than the last."""
        self.times_ns.append(max(time_ns, self.times_ns[-1]) if self.times_ns else time_ns)
        self.items.append(item)

    def count(self, time_ns: int) -> int:
        """How many there were by then."""
        return bisect_right(self.times_ns, time_ns)

    def newest(self, time_ns: int) -> T | None:
        """The newest by then."""
        count = self.count(time_ns)
        return self.items[count - 1] if count else None


class Timeline:
    """The recordings at ``path`` and, where there is one of its session, the controller's.

    ``first_ns`` and ``last_ns`` on vision's clock. Frames, observations, looks and states are kept as they
    were written, pictures in the file: ``images`` are captures of the left eye's, ``image_logs`` when each
    was written, by eye and capture. ``damages``: what could not be read; ``without_states``: why there is
    nothing of the controller.
    """

    def __init__(self, recording: RecordedVision, controller: Path) -> None:
        """Read them. Raises OSError, RecordingUnreadable (``recording.empty``)."""
        self.recording = recording
        self.frames: Series[RecordedStamp] = Series()
        self.observations: Series[bytes] = Series()
        self.looks: Series[bytes] = Series()
        self.events: Series[dict[str, Any]] = Series()
        self.images: Series[int] = Series()
        self.image_logs: dict[tuple[int, int], int] = {}
        self.states: Series[bytes] = Series()
        self.damages: list[Damage] = []
        self.without_states = ""
        self._numbers: dict[int, int] = {}
        clocks = list(self._read_vision())
        if not self.events.times_ns and not self.frames.times_ns:
            raise RecordingUnreadable("recording.empty", f"{recording.path}: nothing happens in it")
        self._read_controller(controller, clocks)
        ends = [each.times_ns for each in (self.frames, self.events, self.states) if each.times_ns]
        self.first_ns, self.last_ns = min(each[0] for each in ends), max(each[-1] for each in ends)

    def state(self, time_ns: int) -> State | None:
        """The controller's newest state by then; counts that are not recorded are zero."""
        data = self.states.newest(time_ns)
        return None if data is None else state_of_message(StateMessage.FromString(data))

    def frame_at(self, capture_ns: int) -> int:
        """The number of the frame of a capture; 0 where none tells."""
        return self._numbers.get(capture_ns, 0)

    def _read_vision(self) -> Iterator[tuple[int, int, int]]:
        """Keep what is shown; yield how the controller's clock stood: its time, vision's minus it, ± (ns)."""
        for topic, record in messages(self.recording.path, _TOPICS, self.damages):
            time_ns = record.log_time
            if topic == topics.FRAME:
                said = own.FrameMessage.FromString(record.data)
                stamp = RecordedStamp(*(getattr(said, name) for name in RecordedStamp._fields))
                self.frames.add(time_ns, stamp)
                self._numbers[stamp.capture_ns] = stamp.frame_id
            elif topic == topics.OBSERVATION:
                self.observations.add(time_ns, record.data)
            elif topic == topics.LOOK:
                self.looks.add(time_ns, record.data)
            elif topic == topics.EVENT:
                self.events.add(time_ns, fields_of(record.data))
            elif topic == topics.CLOCK:
                clock = own.ClockMessage.FromString(record.data)
                yield time_ns + clock.offset_ns, -clock.offset_ns, clock.uncertainty_ns
            else:
                eye = topics.IMAGES.index(topic)
                self.image_logs[eye, record.publish_time] = time_ns
                if eye == 0:
                    self.images.add(time_ns, record.publish_time)

    def _read_controller(self, path: Path, clocks: list[tuple[int, int, int]]) -> None:
        if not path.is_file():
            self.without_states = f"there is no {path}"
        elif metadata_of(path).get("session", {}).get("id") != self.recording.session.get("id"):
            self.without_states = f"{path} is of another session"
        elif not clocks:
            self.without_states = "the recording does not tell how the controller's clock stood"
        if self.without_states:
            return
        clock, last = fitted_clock(clocks), None
        for _, record in messages(path, (STATE,), self.damages):
            said = StateMessage.FromString(record.data)
            now = (said.group_state, said.fault, said.flags)
            time_ns = clock.on_vision(record.log_time)
            due = last is None or now != last or time_ns >= self.states.times_ns[-1] + _STATE_EVERY_NS
            if due:
                self.states.add(time_ns, record.data)
                last = now
