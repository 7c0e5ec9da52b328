"""Arm and eyes that tell a recorder every answer that a program gets from them; the answers are their own."""

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from typing import Protocol, TypeVar

from vision_pc.application.application import VisionApplication
from vision_pc.application.ports import StoppableArm
from vision_pc.core.perception.watch import Odometry, Sensor
from vision_pc.core.ports import ArmView, Eyes, ReferenceStream, Watch
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraErrors,
    FrameObservation,
    Look,
    OdometryPose,
    StereoPair,
    WatchHealth,
    WatchSample,
)
from vision_pc.shell.recording.read_messages import NumberedSample, Read
from vision_pc.shell.recording.vision_messages import ToldWithFrame


class MeasurementRecord(Protocol):
    """Where measurements go; ``VisionRecorder`` writes them down."""

    def observed(
        self, pair: StereoPair, previous: FrameObservation | None, found: FrameObservation
    ) -> None: ...
    def odometry_begun(self, previous: FrameObservation | None) -> int: ...
    def tracked(
        self, odometry: int, pair: StereoPair, told: ToldWithFrame, found: OdometryPose | str
    ) -> None: ...
    def fitted(self, samples: Sequence[WatchSample], found: CameraErrors | None) -> None: ...


class RecordedSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` over another one."""

    def __init__(self, sensor: Sensor[StereoPair], record: MeasurementRecord) -> None:
        self._sensor = sensor
        self._record = record

    def observe(self, frame: StereoPair, previous: FrameObservation | None, /) -> FrameObservation:
        """What the sensor sees."""
        found = self._sensor.observe(frame, previous)
        self._record.observed(frame, previous, found)
        return found

    def odometry(self, previous: FrameObservation | None, /) -> "RecordedOdometry":
        """The sensor's odometry, recorded too."""
        return RecordedOdometry(
            self._sensor.odometry(previous), self._record, self._record.odometry_begun(previous)
        )

    def errors(self, samples: Sequence[WatchSample], /) -> CameraErrors | None:
        """What the sensor makes of the samples."""
        found = self._sensor.errors(samples)
        self._record.fitted(samples, found)
        return found


class RecordedOdometry:
    """Implements ``vision_pc.core.perception.watch.Odometry`` over another one, the ``number``-th."""

    def __init__(self, odometry: Odometry[StereoPair], record: MeasurementRecord, number: int) -> None:
        self._odometry = odometry
        self._record = record
        self._number = number

    @property
    def last_loss(self) -> str | None:
        """Why the last frame was lost."""
        return self._odometry.last_loss

    def process(
        self, frame: StereoPair, X_CM: Array | None = None, X_BT: Array | None = None, /
    ) -> OdometryPose | None:
        """What the odometry makes of the frame."""
        found = self._odometry.process(frame, X_CM, X_BT)
        told = ToldWithFrame(X_CM is not None, X_BT)
        self._record.tracked(self._number, frame, told, found or self._odometry.last_loss or "lost")
        return found


T = TypeVar("T")


class ReadRecord(Protocol):
    """Where answers go; ``VisionRecorder`` writes them down."""

    @property
    def looks(self) -> int:
        """How many looks were recorded."""
        ...

    def read(self, read: Read) -> None: ...
    def sampled(self, made: NumberedSample) -> None: ...


def record_programs(application: VisionApplication, record: ReadRecord) -> None:
    """Have everything recorded that programs of ``application`` read of arm and eyes from now on."""
    application.tap(lambda arm: RecordedArm(arm, record), lambda eyes: RecordedEyes(eyes, record))


class RecordedArm:
    """Implements ``vision_pc.application.ports.StoppableArm`` over another one."""

    def __init__(self, arm: StoppableArm, record: ReadRecord) -> None:
        self._arm = arm
        self._record = record

    async def view(self) -> ArmView:
        """As the arm's."""
        return await _viewed(self._record, "arm.view", self._arm.view())

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        """As the arm's."""
        moving = self._arm.move_to(X_BT_ref, duration_s=duration_s)
        return await _viewed(self._record, "arm.move_to", moving)

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        """As the arm's."""
        moving = self._arm.follow(waypoints, segment_s=segment_s, dwell_s=dwell_s)
        return await _viewed(self._record, "arm.follow", moving)

    def streaming(self) -> AbstractAsyncContextManager[ReferenceStream]:
        """As the arm's."""

        def tapped(made: ReferenceStream) -> ReferenceStream:
            return RecordedStream(made, self._record)

        return _within(self._record, "stream", self._arm.streaming(), tapped)

    async def stop(self) -> None:
        """As the arm's."""
        await _done(self._record, "arm.stop", self._arm.stop())

    async def halt(self) -> None:
        """As the arm's."""
        await _done(self._record, "arm.halt", self._arm.halt())


class RecordedStream:
    """Implements ``vision_pc.core.ports.ReferenceStream`` over another one."""

    def __init__(self, stream: ReferenceStream, record: ReadRecord) -> None:
        self._stream = stream
        self._record = record

    async def send(
        self, X_BT_ref: Array, measured_ns: int | None = None, twist_ref: Array | None = None
    ) -> None:
        """As the stream's."""
        await _done(self._record, "stream.send", self._stream.send(X_BT_ref, measured_ns, twist_ref))

    async def view(self) -> ArmView:
        """As the stream's."""
        return await _viewed(self._record, "stream.view", self._stream.view())


class RecordedEyes:
    """Implements ``vision_pc.core.ports.Eyes`` over other ones, whose looks are recorded before."""

    def __init__(self, eyes: Eyes, record: ReadRecord) -> None:
        self._eyes = eyes
        self._record = record
        self._watches = 0

    async def look(self, frames: int | None = None) -> Look:
        """As the eyes'."""
        with _errors_told(self._record, "eyes.look"):
            look = await self._eyes.look(frames)
        self._record.read(Read("eyes.look", look=self._record.looks))
        return look

    def watch(self, *, markers: bool, odometry: bool) -> AbstractAsyncContextManager[Watch]:
        """As the eyes'."""
        self._watches += 1
        number = self._watches
        watching = self._eyes.watch(markers=markers, odometry=odometry)

        def tapped(made: Watch) -> Watch:
            return RecordedWatch(made, self._record, number)

        return _within(self._record, "watch", watching, tapped, number)


class RecordedWatch:
    """Implements ``vision_pc.core.ports.Watch`` over another one, the ``number``-th.

    A sample is recorded when a program may first see it, and again if it is another one by then: the newest
    is, once the camera's errors were found.
    """

    def __init__(self, watch: Watch, record: ReadRecord, number: int) -> None:
        self._watch = watch
        self._record = record
        self._number = number
        self._told: list[WatchSample] = []

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        """As the watch's."""
        samples = self._watch.samples
        self._tell(samples)
        self._record.read(Read("watch.samples", watch=self._number, samples=len(samples)))
        return samples

    @property
    def health(self) -> WatchHealth:
        """As the watch's."""
        health = self._watch.health
        self._record.read(Read("watch.health", watch=self._number, health=health))
        return health

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        """As the watch's."""
        with _errors_told(self._record, "watch.after"):
            sample = await self._watch.after(count, timeout_s)
        given = None
        if sample is not None:
            samples = self._watch.samples  # there may be more by now
            given = next(place for place in range(len(samples), 0, -1) if samples[place - 1] is sample)
            self._tell(samples[:given])
        self._record.read(Read("watch.after", watch=self._number, samples=given))
        return sample

    def _tell(self, samples: tuple[WatchSample, ...]) -> None:
        begin = len(self._told)
        if 0 < begin <= len(samples) and samples[begin - 1] is not self._told[-1]:
            begin -= 1
        for number in range(begin, len(samples)):
            self._record.sampled(NumberedSample(self._number, number, samples[number]))
        self._told[begin:] = samples[begin:]


@asynccontextmanager
async def _within(
    record: ReadRecord,
    name: str,
    block: AbstractAsyncContextManager[T],
    tapped: Callable[[T], T],
    number: int | None = None,
) -> AsyncIterator[T]:
    """``block`` with what it gives ``tapped``; its begin and its end are told, or that it was broken off."""
    with _errors_told(record, f"{name}.begin"):
        given = await block.__aenter__()
    record.read(Read(f"{name}.begin", watch=number))
    try:
        yield tapped(given)
    except BaseException as error:
        try:
            await block.__aexit__(type(error), error, error.__traceback__)
        finally:
            record.read(Read(f"{name}.broken"))
        raise
    await _done(record, f"{name}.end", block.__aexit__(None, None, None))


async def _viewed(record: ReadRecord, call: str, asked: Awaitable[ArmView]) -> ArmView:
    with _errors_told(record, call):
        view = await asked
    record.read(Read(call, view=view))
    return view


async def _done(record: ReadRecord, call: str, asked: Awaitable[object]) -> None:
    with _errors_told(record, call):
        await asked
    record.read(Read(call))


@contextmanager
def _errors_told(record: ReadRecord, call: str) -> Iterator[None]:
    try:
        yield
    except BaseException as error:
        record.read(Read(call, error))
        raise
