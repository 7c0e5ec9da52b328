"""Vision's perception run again over a recording: the same frames in the same order, with its own code.

Every observation goes on from the one that it went on from then, as it comes out now: nothing but pixels, the
arm's poses and the order is taken from the recording.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from foundation.recording.decoding import Damage, RecordingUnreadable, messages
from protocol.errors import MeasurementFailed
from testbed.recordings.comparison import ReplayComparison
from testbed.recordings.pixels import KeptPixels, Pixels, RecordedStamp, RenderedPixels, checked
from testbed.recordings.recorded_vision import RecordedVision
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception.look import combine
from vision_pc.core.pixel_sensor import PixelSensor
from vision_pc.core.types import CameraErrors, FrameObservation, OdometryPose, StereoPair, WatchSample
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_recorder as topics

_CLASSES: dict[str, Any] = {
    topics.FRAME: own.FrameMessage,
    topics.OBSERVATION: own.ObservationMessage,
    topics.ODOMETRY_START: own.OdometryStartMessage,
    topics.ODOMETRY: own.OdometryMessage,
    topics.ERRORS: own.CameraErrorsMessage,
    topics.LOOK: own.LookMessage,
    topics.IMAGES[0]: RawImage,
    topics.IMAGES[1]: RawImage,
}
_KEPT_FRAMES = 4
_KEPT_OBSERVATIONS = 1100  # more than the frames of any look
FRAME, OBSERVATION, ODOMETRY, ERRORS, LOOK = "frame", "observation", "odometry pose", "camera errors", "look"


def pixels_for(recording: RecordedVision, truth: Path | None) -> Pixels:
    """The recording's own pictures, or those rendered again from the plant's recording of its session.

    ``truth``: that recording; None: where `longreach up` leaves it. Raises RecordingUnreadable.
    """
    if not recording.pictured:
        why = f"{recording.path.name} is of simulated measurements, which have no pictures"
        raise RecordingUnreadable("recording.no_pictures", why)
    if truth is None and recording.images == "raw":
        return KeptPixels()
    source = truth or recording.run / "plant_emulator" / "truth.mcap"
    if not source.is_file():
        why = f"{recording.path.name} holds no whole pictures and there is no {source}; --truth names it"
        raise RecordingUnreadable("recording.no_pictures", why)
    return RenderedPixels(source)


class PerceptionReplay:
    """Takes a recording's messages in their order.

    ``damages``: what of the file could not be read; ``recorded_s``: how long it is.
    """

    def __init__(self, recording: RecordedVision, pixels: Pixels) -> None:
        self.comparison = ReplayComparison(recording.exact)
        self.damages: list[Damage] = []
        self.recorded_s = 0.0
        self._recording = recording
        self._pixels = pixels
        self._sensor = PixelSensor(recording.config)
        self._pairs: dict[tuple[int, int], StereoPair] = {}
        self._observations: dict[int, FrameObservation] = {}
        self._at: dict[int, FrameObservation] = {}
        self._poses: dict[int, OdometryPose] = {}
        self._odometry: dict[int, StereoOdometry] = {}
        self._errors: CameraErrors | None = None
        self._looks = 0

    def run(self) -> ReplayComparison:
        """Replay all of it.

        Raises RecordingUnreadable for a frame without pictures (``recording.missing_frame``).
        """
        takers: dict[str, Callable[[Any], None]] = {
            topics.OBSERVATION: self._observation,
            topics.ODOMETRY_START: self._odometry_start,
            topics.ODOMETRY: self._replay_track,
            topics.ERRORS: self._replay_fit,
            topics.LOOK: self._look,
        }
        first_ns = 0
        frames: list[Any] = []  # wait for their pictures, which follow them
        for topic, record in messages(self._recording.path, _CLASSES, self.damages):
            if topic in topics.IMAGES:
                if isinstance(self._pixels, KeptPixels) and self._recording.images == "raw":
                    self._pixels.add(topics.IMAGES.index(topic), RawImage.FromString(record.data))
                continue
            item = _CLASSES[topic].FromString(record.data)
            if topic == topics.FRAME:
                frames.append(item)
                continue
            while frames:
                self._frame(frames.pop(0))
            takers[topic](item)
            first_ns = first_ns or record.log_time
            self.recorded_s = 1e-9 * (record.log_time - first_ns)
        return self.comparison

    def _frame(self, item: Any) -> None:
        stamp = RecordedStamp(*(getattr(item, name) for name in RecordedStamp._fields))
        eyes = self._pixels.of(stamp)
        if eyes is None:
            why = f"frame {stamp.frame_id}: neither kept nor in the plant's recording"
            raise RecordingUnreadable("recording.missing_frame", why)
        wrong = checked(stamp, eyes)
        if wrong:
            eye, before, now = wrong[0]
            difference = (f"CRC-32 of the {eye} eye's pixels", f"{before:#010x}", f"{now:#010x}")
            self.comparison.different(FRAME, stamp.frame_id, stamp.capture_ns, *difference)
        else:
            self.comparison.same(FRAME)
        self._pairs[stamp.frame_id, stamp.capture_ns] = StereoPair(*eyes, stamp.capture_ns, stamp.frame_id)
        while len(self._pairs) > _KEPT_FRAMES:
            del self._pairs[next(iter(self._pairs))]

    def _observation(self, item: Any) -> None:
        previous = self._replayed_observation(item)
        found = self._sensor.observe(self._pair(item), previous)
        before = item.previous if item.HasField("previous") else None
        again = own.observation_bytes(item.number, before, item.corrected, found)
        self._observations[item.number] = self._at[found.capture_ns] = found
        self._observations.pop(item.number - _KEPT_OBSERVATIONS, None)
        self.comparison.message(OBSERVATION, item.frame_id, item, again)

    def _odometry_start(self, item: Any) -> None:
        self._odometry = {item.odometry: self._sensor.own_odometry(self._replayed_observation(item))}
        self._at = {time_ns: seen for time_ns, seen in self._at.items() if time_ns == max(self._at)}
        self._poses.clear()

    def _replay_track(self, item: Any) -> None:
        pair = self._pair(item)
        seen = self._at.get(pair.capture_ns)
        X_CM = seen.X_CM if item.tool_given and seen is not None else None
        odometry = self._odometry[item.odometry]
        X_BT = np.reshape(item.X_BT, (4, 4)) if item.X_BT else None
        found = odometry.process(pair, X_CM, X_BT)
        if found is not None:
            self._poses[pair.capture_ns] = found
        outcome, frame = found or odometry.last_loss or "lost", (pair.frame_id, pair.capture_ns)
        again = own.tracked_bytes(item.odometry, frame, X_CM is not None, X_BT, outcome)
        self.comparison.message(ODOMETRY, item.frame_id, item, again)

    def _replay_fit(self, item: Any) -> None:
        captures = tuple(item.captures_ns)
        found = self._sensor.errors([self._sample(capture_ns) for capture_ns in captures])
        self._errors = found or self._errors
        self.comparison.message(ERRORS, len(captures), item, own.fitted_bytes(captures, found))

    def _look(self, item: Any) -> None:
        self._looks += 1
        numbers = tuple(item.observations)
        seen = [self._observations[number] for number in numbers if number in self._observations]
        if len(seen) < len(numbers):
            difference = f"{len(numbers) - len(seen)} of {len(numbers)} observations are not in the recording"
            self.comparison.different(LOOK, self._looks, item.time_ns, "observations", difference, "not made")
            return
        X_BT = np.reshape(item.X_BT, (4, 4))
        try:
            look = combine(seen, X_BT, item.time_ns, self._recording.config.look)
        except MeasurementFailed as error:
            self.comparison.different(LOOK, self._looks, item.time_ns, "outcome", "a look", error.cause)
            return
        self.comparison.message(LOOK, self._looks, item, own.look_bytes(look, numbers))

    def _pair(self, item: Any) -> StereoPair:
        found = self._pairs.get((item.frame_id, item.capture_ns))
        if found is None:
            why = f"frame {item.frame_id}: measured in, but its pixels were not kept (frames_missed)"
            raise RecordingUnreadable("recording.missing_frame", why)
        return found

    def _replayed_observation(self, item: Any) -> FrameObservation | None:
        """The observation that this one went on from, as it came out again."""
        if not item.HasField("previous"):
            return None
        found = self._observations.get(item.previous)
        if found is None:
            why = f"observation {item.previous} was made before the recording, or was lost"
            raise RecordingUnreadable("recording.missing_observation", why)
        if item.corrected and self._errors is not None:
            return found._replace(errors=self._errors, offset=self._errors.offset)
        return found

    def _sample(self, capture_ns: int) -> WatchSample:
        seen, pose = self._at.get(capture_ns), self._poses.get(capture_ns)
        return WatchSample(
            capture_ns,
            np.eye(4),
            None if pose is None else pose.X_C0C,
            None if seen is None else seen.X_CM,
            None if seen is None else seen.X_CO,
            seen,
            None if pose is None else pose.pairs,
        )
