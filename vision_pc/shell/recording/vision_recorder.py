"""The vision PC's recorder: its topics, and what becomes a message on which of them.

Nothing is encoded, compressed or written before a call returns: what is put is kept by reference.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration as CalibrationMessage
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from foundation.event_log import Level
from foundation.recording.mcap_file import Topic
from foundation.recording.messages import EventMessage, RecordingThread, event_bytes, format_of, log_line
from foundation.recording.recorder import OpenSink, ServiceRecorder
from protocol.clock_offset import OffsetEstimate
from protocol.reference_messages import Command, Request, StreamedPose
from protocol.session_events import ClientEvent, StateReceived
from vision_pc.application.reference_link import ReferenceLink, Streamed, Submitted
from vision_pc.config.vision import RecordingSettings, VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.perception.watch import Odometry, Sensor
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraErrors, FrameObservation, Look, OdometryPose, StereoPair, WatchSample
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_pictures as pictures

FILE = "vision.mcap"
EYES, SIMULATED = "eyes", "simulated"  # in the metadata `session`, where there were no pictures
FRAME, OBSERVATION, LOOK = "/vision/frame", "/vision/observation", "/vision/look"
ODOMETRY_START, ODOMETRY, ERRORS = "/vision/odometry_start", "/vision/odometry", "/vision/camera_errors"
REFERENCE, CLOCK, EVENT, LOG = "/vision/reference", "/vision/clock", "/vision/event", "/vision/log"
FRAMES, TRACK, PATH = "/vision/tf", "/vision/track", "/vision/path"
ANNOTATIONS = "/camera/left/annotations"
CALIBRATIONS = ("/camera/left/calibration", "/camera/right/calibration")
IMAGES = ("/camera/left/image", "/camera/right/image")

WAITING_FRAMES = 20  # [D] two seconds at 10 a second, 37 MB of pixels: more are left out, and counted
_JPEG_QUALITY = 85  # [D]
_JPEG_HZ = 1.0  # [M] 9 MB a minute
_CLOCK_NS = 1_000_000_000
_REMEMBERED = 1001  # observations, some 8 MB: as many as a look may take, and the one before


def _spread(encode: Callable[..., bytes]) -> Callable[[tuple[Any, ...]], bytes]:
    """What makes a message of several things that are put together."""
    return lambda content: encode(*content)


def topics(settings: RecordingSettings) -> tuple[Topic, ...]:
    """The topics of a recording, those of pictures as ``settings`` want them."""
    eyes = {"none": 0, "jpeg": 1, "raw": 2}[settings.images]
    shown = pictures.jpeg(_JPEG_QUALITY) if settings.images == "jpeg" else pictures.raw
    image = format_of(CompressedImage if settings.images == "jpeg" else RawImage)
    return (
        Topic(FRAME, format_of(own.FrameMessage), own.frame_bytes),
        Topic(OBSERVATION, format_of(own.ObservationMessage), _spread(own.observation_bytes)),
        Topic(ODOMETRY_START, format_of(own.OdometryStartMessage), _spread(own.start_bytes)),
        Topic(ODOMETRY, format_of(own.OdometryMessage), _spread(own.tracked_bytes)),
        Topic(ERRORS, format_of(own.CameraErrorsMessage), _spread(own.fitted_bytes)),
        Topic(LOOK, format_of(own.LookMessage), _spread(own.look_bytes)),
        Topic(REFERENCE, format_of(own.ReferenceMessage), _spread(own.reference_bytes)),
        Topic(CLOCK, format_of(own.ClockMessage), own.clock_bytes),
        Topic(EVENT, format_of(EventMessage), event_bytes),
        Topic(LOG, format_of(LogMessage), _spread(log_line)),
        Topic(FRAMES, format_of(FrameTransforms), pictures.seen_frames),
        Topic(TRACK, format_of(PoseInFrame), pictures.track_pose),
        Topic(PATH, format_of(PosesInFrame), _spread(pictures.path)),
        Topic(ANNOTATIONS, format_of(ImageAnnotations), pictures.annotations),
        *(Topic(name, format_of(CalibrationMessage), bytes, once=True) for name in CALIBRATIONS),
        *(Topic(name, image, _spread(shown)) for name in IMAGES[:eyes]),
    )


class RecordedSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` over another one."""

    def __init__(self, sensor: Sensor[StereoPair], record: "VisionRecorder") -> None:
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

    def __init__(self, odometry: Odometry[StereoPair], record: "VisionRecorder", number: int) -> None:
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
        outcome = found or self._odometry.last_loss or "lost"
        self._record.tracked(self._number, frame, X_CM is not None, X_BT, outcome)
        return found


class VisionRecorder(ServiceRecorder):
    """Implements ``SightRecorder`` and a listener of the link.

    ``missed``: frames of which neither checksum nor pixels were kept, because too many waited.
    Measurements may be told by one thread while looks and references are told by another.
    """

    def __init__(
        self,
        path: Path,
        config: VisionConfig,
        run: Mapping[str, Any],
        session: Mapping[str, str],
        now_ns: Callable[[], int],
        made: OpenSink = RecordingThread,
    ) -> None:
        """Create ``path``; ``run`` and ``session`` are metadata. Raises ConfigurationError when it cannot be
        written.
        """
        self._frames_put = self._frames_taken = 0
        every = [self._counted_topic(topic) for topic in topics(config.recording)]
        super().__init__(path, every, run, session, made)
        self.missed = 0
        self._now_ns = now_ns
        self._settings = config.recording
        self._camera: tuple[bytes, bytes] | None = pictures.calibrations(calibration(config.camera))
        self._frame: tuple[int, int] | None = None
        self._picture_ns: int | None = None
        self._observations: deque[tuple[int, FrameObservation]] = deque(maxlen=_REMEMBERED)
        self._observed = self._odometries = 0
        self._clock_ns: int | None = None
        self._link: ReferenceLink | None = None

    # Measurements, told by a sensor.
    def tapped(self, sensor: Sensor[StereoPair]) -> RecordedSensor:
        """``sensor``, which is recorded from now on."""
        return RecordedSensor(sensor, self)

    def observed(self, pair: StereoPair, previous: FrameObservation | None, found: FrameObservation) -> None:
        """Record what a frame shows; what was known before it is told by number."""
        self._keep_frame(pair)
        number, corrected = self._number_of(previous)
        self._observed += 1
        self._observations.append((self._observed, found))
        self._put(OBSERVATION, (self._observed, number, corrected, found), pair.capture_ns)
        for topic in (FRAMES, ANNOTATIONS):
            self._put(topic, found, pair.capture_ns)

    def odometry_begun(self, previous: FrameObservation | None) -> int:
        """Record that odometry begins. Return its number."""
        self._odometries += 1
        capture_ns = 0 if previous is None else previous.capture_ns
        start = self._odometries, *self._number_of(previous), capture_ns
        self._put(ODOMETRY_START, start, capture_ns)
        return self._odometries

    def tracked(
        self,
        odometry: int,
        pair: StereoPair,
        tool_given: bool,
        X_BT: Array | None,
        found: OdometryPose | str,
    ) -> None:
        """Record where odometry finds the camera, or why it does not."""
        self._keep_frame(pair)
        frame = pair.frame_id, pair.capture_ns
        self._put(ODOMETRY, (odometry, frame, tool_given, X_BT, found), pair.capture_ns)
        if isinstance(found, OdometryPose):
            self._put(TRACK, found, pair.capture_ns)

    def fitted(self, samples: Sequence[WatchSample], found: CameraErrors | None) -> None:
        """Record the camera's errors as found from samples."""
        captures = tuple(sample.time_ns for sample in samples)
        self._put(ERRORS, (captures, found), captures[-1] if captures else 0)

    def looked(self, look: Look, observations: Sequence[FrameObservation]) -> None:
        """Record a look."""
        numbers = tuple(self._number_of(each)[0] for each in observations)
        known = tuple(-1 if number is None else number for number in numbers)
        self._put(LOOK, (look, known), look.time_ns, wanted=True)

    # Told by the link and by the log.
    def listen_to(self, link: ReferenceLink) -> None:
        """Record the references that go out over ``link``, and how the clocks stand."""
        self._link = link
        link.listeners.append(self._on_event)

    def _on_event(self, event: Submitted | Streamed | ClientEvent) -> None:
        match event:
            case Submitted():
                self._reference(event.command_id, event.request)
            case Streamed():
                self._reference(event.reference.number, event.reference)
            case StateReceived() if self._link is not None:
                self._clock(self._link.session.clock)

    def event(self, name: str, level: Level, fields: Mapping[str, Any]) -> None:
        """Record an event of the log, for programs and for people."""
        now_ns = self._now_ns()
        self._put(EVENT, {"event": name, **fields}, now_ns, wanted=True)
        words = ", ".join(f"{key} {value}" for key, value in fields.items() if not isinstance(value, dict))
        self._put(LOG, (now_ns, level, "vision_pc", f"{name} {words}".strip()), now_ns, wanted=True)

    def counts(self) -> dict[str, int]:
        """Messages written and dropped, and frames left out."""
        return {"written": self.sink.written, "dropped": self.sink.dropped, "frames_missed": self.missed}

    def _reference(self, number: int, request: Request | StreamedPose) -> None:
        now_ns = self._now_ns()
        self._put(REFERENCE, (number, request), now_ns, wanted=True)
        if not isinstance(request, Command):
            self._put(PATH, (now_ns, own.poses_of(request)), now_ns)

    def _clock(self, estimate: OffsetEstimate | None) -> None:
        now_ns = self._now_ns()
        if estimate is None or (self._clock_ns is not None and now_ns - self._clock_ns < _CLOCK_NS):
            return
        self._clock_ns = now_ns
        self._put(CLOCK, (estimate.offset_ns, estimate.uncertainty_ns), now_ns, wanted=True)

    def _number_of(self, observation: FrameObservation | None) -> tuple[int | None, bool]:
        """The number of an observation, and whether camera errors were put into it since."""
        if observation is None:
            return None, False
        for number, found in reversed(self._observations):
            if found is observation:
                return number, False
            if found.capture_ns == observation.capture_ns and found.X_CM is observation.X_CM:
                return number, True
        return -1, False

    def _keep_frame(self, pair: StereoPair) -> None:
        """Record a frame's checksums, and its pictures where they are wanted, once."""
        if self._frame == (pair.frame_id, pair.capture_ns):
            return
        self._frame = pair.frame_id, pair.capture_ns
        if self._camera is not None:
            for topic, content in zip(CALIBRATIONS, self._camera, strict=True):
                self._put(topic, content, pair.capture_ns, wanted=True)
            self._camera = None
        if self.sink.wants(self._numbers[FRAME]):
            if self._frames_put - self._frames_taken >= WAITING_FRAMES:
                self.missed += 1
                return
            self._frames_put += 1
            self._put(FRAME, pair, pair.capture_ns, wanted=True)
        if self._picture_due(pair.capture_ns):
            for eye, topic in enumerate(IMAGES):
                if topic in self._numbers:
                    self._put(topic, (pair, eye), pair.capture_ns, wanted=True)

    def _picture_due(self, capture_ns: int) -> bool:
        if self._settings.images != "jpeg":
            return True
        period_ns = 1e9 / _JPEG_HZ
        if self._picture_ns is not None and capture_ns - self._picture_ns < period_ns:
            return False
        self._picture_ns = capture_ns
        return True

    def _counted_topic(self, topic: Topic) -> Topic:
        """A topic of frames that counts down when one no longer waits."""
        if topic.name != FRAME:
            return topic

        def encode(pair: StereoPair) -> bytes:
            self._frames_taken += 1
            return topic.encode(pair)

        return topic._replace(encode=encode)

    def _put(self, topic: str, message: Any, stamp_ns: int, *, wanted: bool = False) -> None:
        self.put(topic, message, self._now_ns(), stamp_ns, wanted=wanted)
