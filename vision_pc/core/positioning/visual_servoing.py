"""Visual servoing, position-based and eye-in-hand: each picture of tool and object moves the reference.

Mäkinen et al. 2023 name it "looking and moving", possible with an uninterrupted view. Every picture gives the
error (21) at the instant of its exposure. The local error model's rotation turns it into the base (20), and
the pose that the controller had at that instant makes it a target (22). The arm follows the filtered target
as a stream of references that runs at most ``lead_m`` ahead. Near the object the target is held. What is left
is added to the reference only when the tool has come to rest: in the joints' backlash the encoders move and
the tool does not, so a target that followed every picture would hunt. One picture may move the reference by a
bounded step; without a fresh view of both the loop stops.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.programs import VisualServoingSettings
from vision_pc.core.ports import Arm, Eyes, ReferenceStream, Report, Watch
from vision_pc.core.positioning.expected_end import ExpectedEnd, expected_end
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import FrameObservation, WatchSample

_PULL_M = 0.01  # [D] from where the pictures see the object: three times the servo's floor
_LOST_S = 0.5  # [D] five pictures: held since the second, then stopped
_FROZEN_PICTURES = 4  # [D] alike to the last digit
_RESTS = 5  # so often at rest outside what is accepted: not slow, but loose
_FEED_S = 0.03  # [D] between references; the controller slows down after 76 ms without one
_HOLD_S = 0.2  # [D] two pictures without a view: the controller refuses what was seen more than 250 ms ago
_STILL_M = 0.0004  # [M] a look's noise is 0.1 mm
_SIGMAS_95 = 1.96
_SETTLE_DEPTH_M = 0.005  # [D]


class Convergence(NamedTuple):
    """How looking and moving ended.

    ``end``: the error as the last pictures have it, with what they share of error, and the probability that
    |e_x| and |e_y| are within ``limit_m``. ``time_s`` from the first picture to the last; ``pictures`` showed
    tool and object, ``missed`` did not.
    """

    end: ExpectedEnd
    limit_m: float
    time_s: float
    pictures: int
    missed: int


class ServoingLaw:
    """The law itself, picture by picture: pure, its time is that of the pictures.

    ``R_TC`` (3×3) turns camera axes into the tool's; ``hold`` the tool's orientation (3×3) in B, kept.
    """

    def __init__(self, R_TC: Array, hold: Array, clearance_m: float, settings: VisualServoingSettings):
        self._R_TC = R_TC
        self._hold = hold
        self._clearance = np.array([0.0, 0.0, clearance_m])
        self._settings = settings
        self._target: Array | None = None
        self._gap_m = 0.0
        self._pulls = 0
        self._newest: FrameObservation | None = None
        self.nearest_m = math.inf  # at rest, worse of |x| and |y|; inf before the first rest
        self.newest = np.zeros(3)  # error (3,) in camera axes that the last picture showed
        self._errors: deque[Array] = deque(maxlen=settings.settle_pictures)
        self._left: deque[Array] = deque(maxlen=settings.settle_pictures)
        self._measured: deque[Array] = deque(maxlen=settings.settle_pictures)

    @property
    def errors(self) -> Array:
        """The errors (n, 3) in camera axes since the last pull, at most ``settle_pictures``."""
        return np.array(self._errors).reshape(-1, 3)

    def update(self, sample: WatchSample, servo_gap_m: float = 0.0) -> None:
        """Move the target by what this sample shows, which has both tool and object.

        ``servo_gap_m``: how far the encoders are from what is commanded; while the joint servo still works
        at that, the tool will move again.
        """
        assert sample.X_CM is not None
        assert sample.X_CO is not None
        s = self._settings
        c_delta = sample.X_CO[:3, 3] - sample.X_CM[:3, 3] - self._clearance  # (21)
        left = sample.X_BT[:3, :3] @ self._R_TC @ c_delta  # (20)
        measured = sample.X_BT[:3, 3] + left
        if self._target is None:
            self._target = measured
        elif np.linalg.norm(left) > s.near_m:
            self._target = self._target + _shorten(s.gain * (measured - self._target), s.step_m)
        self.newest, self._newest = c_delta, sample.observation
        self._errors.append(c_delta)
        self._left.append(left)
        self._measured.append(measured)
        self._gap_m = servo_gap_m
        if self._still and not self.settled:
            left, there = np.mean(self._left, axis=0), np.mean(self._measured, axis=0)
            pulled = self._target + _shorten(s.pull_gain * left, s.step_m)
            self._target = there + _shorten(pulled - there, _PULL_M)
            self._pulls += 1
            self.nearest_m = min(self.nearest_m, float(np.abs(self.errors.mean(axis=0))[:2].max()))
            for kept in (self._errors, self._left, self._measured):
                kept.clear()

    def reference(self, X_BT_cmd: Array) -> Array:
        """X_BT_ref: the target, no farther than ``lead_m`` from the pose that is commanded at present."""
        assert self._target is not None
        ahead = self._target - X_BT_cmd[:3, 3]
        return transform(self._hold, X_BT_cmd[:3, 3] + _shorten(ahead, self._settings.lead_m))

    @property
    def rests(self) -> int:
        """How often the tool came to rest elsewhere, and was pulled."""
        return self._pulls

    @property
    def settled(self) -> bool:
        """Whether the last pictures agree that the tool is there, and that it rests."""
        if not self._still:
            return False
        mean = np.abs(self.errors.mean(axis=0))
        return bool(max(mean[:2]) <= self.inside_m and mean[2] <= _SETTLE_DEPTH_M)

    @property
    def inside_m(self) -> float:
        """What the mean error at rest may be.

        Each correction ends somewhere in the backlash. Where that is wider than ``settle_m``, waiting for a
        better end could go on for ever: after a rest outside, an end is good that is within ``wanted_m`` in
        19 of 20 cases by what the pictures know of their error.
        """
        s = self._settings
        if self._pulls == 0:
            return s.settle_m
        std_m = math.sqrt(float(np.diag(self.covariance)[:2].max()))
        return max(s.settle_m, s.wanted_m - _SIGMAS_95 * std_m)

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) m² of the mean of ``errors``: their noise goes down, what they share stays."""
        count, seen = max(len(self._errors), 1), self._newest
        if seen is None or seen.cov_CM is None or seen.cov_CO is None:
            return np.atleast_2d(np.cov(self.errors.T)) / count if count > 1 else np.zeros((3, 3))
        assert seen.bias_CM is not None
        assert seen.bias_CO is not None
        shared = seen.bias_CM + seen.bias_CO
        return np.asarray(shared + (seen.cov_CM + seen.cov_CO - shared) / count)[:3, :3]

    @property
    def _still(self) -> bool:
        """Whether the tool rests, at the object or not, and the joint servo has done what it can."""
        if len(self._errors) < self._settings.settle_pictures or self._gap_m > self._settings.servo_gap_m:
            return False
        errors, part = self.errors, self._settings.settle_pictures // 3
        moved = float(np.linalg.norm(errors[-part:].mean(axis=0) - errors[:part].mean(axis=0)))
        spread = float(errors[:, :2].std(axis=0).max())
        return max(moved, spread) <= _STILL_M


async def servo_to_object(
    arm: Arm,
    eyes: Eyes,
    report: Report,
    settings: VisualServoingSettings,
    clearance_m: float,
    R_TC: Array,
) -> Convergence:
    """The approach, once the error has settled inside ``settle_m`` in x and y.

    ``R_TC`` from a local calibration or map. Raises MeasurementFailed with the arm stopped: ``view_lost``
    (tool or object unseen for half a second), ``camera_silent``, ``camera_frozen``, ``step_too_large``,
    ``not_settled`` after ``timeout_s``, ``play_too_wide`` when it had come to rest by then, but never there;
    errors of arm and eyes pass through.
    """
    report(0.0, "looking")
    async with eyes.watch(markers=True, odometry=False) as watch:
        detections = _Detections(watch, settings)
        first = await detections.first()
        law = ServoingLaw(R_TC, first.X_BT[:3, :3], clearance_m, settings)
        law.update(first)
        start = float(np.linalg.norm(law.newest))
        if not start <= settings.step_limit_m:
            raise MeasurementFailed(
                "measurement.step_too_large",
                f"looking and moving: {start:.3f} m to go, limit {settings.step_limit_m:g} m",
            )
        async with arm.streaming() as stream:
            await _follow_object(stream, detections, law, first, start, report)
    limit_m = max(settings.settle_m, settings.wanted_m)
    end = expected_end(law.errors.mean(axis=0), law.covariance, limit_m)
    x, y = 1e3 * end.mean_m[:2]
    report(1.0, f"settled: error {x:+.1f} {y:+.1f} mm, {end.inside:.2f} to be within {1e3 * limit_m:g} mm")
    time_s = 1e-9 * (detections.newest_ns - first.time_ns)
    return Convergence(end, limit_m, time_s, detections.pictures, detections.missed)


async def _follow_object(
    stream: ReferenceStream,
    detections: "_Detections",
    law: ServoingLaw,
    first: WatchSample,
    start: float,
    report: Report,
) -> None:
    """Follow the object until the loop has settled: one reference with every picture, and more between.

    When the newest sight is older than ``_HOLD_S``, the arm is held where it is until there is another.
    """
    settings, seen_ns = detections.settings, first.time_ns
    held: Array | None = None
    while not law.settled:
        view = await stream.view()
        if 1e-9 * (view.time_ns - seen_ns) > _HOLD_S:
            held = view.X_BT_cmd if held is None else held
            await stream.send(held)
        else:
            held = None
            await stream.send(law.reference(view.X_BT_cmd), measured_ns=seen_ns)
        sample = await detections.next()
        if sample is None:
            continue
        law.update(sample, float(np.linalg.norm(view.X_BT_cmd[:3, 3] - view.X_BT[:3, 3])))
        seen_ns = sample.time_ns
        left = float(np.linalg.norm(law.newest))
        report(min(0.95, max(0.0, 1.0 - left / max(start, 1e-3))), f"{1e3 * left:.1f} mm to go")
        if 1e-9 * (seen_ns - first.time_ns) > settings.timeout_s:
            raise _unsettled(law, left, settings)


def _unsettled(law: ServoingLaw, left: float, settings: VisualServoingSettings) -> MeasurementFailed:
    """Why the time was not enough: the tool never came to rest, or it always did beside the object."""
    off = f"looking and moving: {1e3 * left:.1f} mm off after {settings.timeout_s:g} s"
    if law.rests < _RESTS:
        return MeasurementFailed("measurement.not_settled", off)
    most_mm = 1e3 * law.inside_m
    return MeasurementFailed(
        "measurement.play_too_wide",
        f"{off}; at rest {law.rests} times, {1e3 * law.nearest_m:.1f} mm off at best, "
        f"{most_mm:.1f} mm are accepted: the joints have more play than that",
    )


class _Detections:
    """The watch's samples one by one, with what is wrong with them."""

    def __init__(self, watch: Watch, settings: VisualServoingSettings) -> None:
        self.settings = settings
        self.newest_ns = 0
        self.pictures = 0
        self.missed = 0
        self._watch = watch
        self._taken = 0
        self._silent_s = 0.0
        self._blind_since_ns: int | None = None
        self._alike = 0
        self._last: WatchSample | None = None

    async def first(self) -> WatchSample:
        """The first sample that shows tool and object. Raises as ``next`` does."""
        while (sample := await self.next()) is None:
            pass
        return sample

    async def next(self) -> WatchSample | None:
        """The next sample with tool and object, None when it is time for another reference without one.

        Raises MeasurementFailed for a view lost, and a camera that is silent or frozen.
        """
        sample = await self._watch.after(self._taken, _FEED_S)
        if sample is None:
            self._silent_s += _FEED_S
            if self._silent_s > _LOST_S:
                raise MeasurementFailed(
                    "measurement.camera_silent",
                    f"looking and moving: no picture for {self._silent_s:.2f} s, limit {_LOST_S:g} s",
                )
            return None
        self._taken, self._silent_s = len(self._watch.samples), 0.0
        self.newest_ns = sample.time_ns
        if sample.X_CM is None or sample.X_CO is None:
            self._count_unseen(sample)
            return None
        self._refuse_frozen(sample)
        self.pictures += 1
        self._blind_since_ns = None
        self._last = sample
        return sample

    def _count_unseen(self, sample: WatchSample) -> None:
        self.missed += 1
        if self._blind_since_ns is None:
            self._blind_since_ns = sample.time_ns if self._last is None else self._last.time_ns
        blind_s = 1e-9 * (sample.time_ns - self._blind_since_ns)
        if blind_s > _LOST_S:
            what = "tool" if sample.X_CM is None else "object"
            raise MeasurementFailed(
                "measurement.view_lost",
                f"looking and moving: {what} unseen for {blind_s:.2f} s, limit {_LOST_S:g} s",
            )

    def _refuse_frozen(self, sample: WatchSample) -> None:
        """Raises when pictures repeat themselves to the last digit: noise forbids it in live ones."""
        last = self._last
        same = last is not None and np.array_equal(sample.X_CO, last.X_CO)  # type: ignore[arg-type]
        self._alike = self._alike + 1 if same else 0
        if self._alike >= _FROZEN_PICTURES:
            raise MeasurementFailed(
                "measurement.camera_frozen",
                f"looking and moving: {self._alike + 1} pictures alike, at most {_FROZEN_PICTURES} "
                "are believed",
            )


def _shorten(step: Array, limit: float) -> Array:
    """``step`` (3,), shortened to ``limit``."""
    length = math.sqrt(float(step @ step))
    return step if length <= limit else step * (limit / length)
