"""The camera's path in a static world, from stereo pairs against a persistent map of keyframes."""

from typing import NamedTuple

import numpy as np

from vision_pc.config.vision import OdometrySettings, ToolMarkerSettings
from vision_pc.core import se3
from vision_pc.core.odometry import tracking
from vision_pc.core.odometry.frame import Frame, PoseEstimate
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.odometry.localisation import Localiser
from vision_pc.core.odometry.map_trust import MapTrust
from vision_pc.core.odometry.mapping import Mapper
from vision_pc.core.odometry.motion_prior import UNDECIDED, Foreseen, History
from vision_pc.core.odometry.moving_regions import static_pixels
from vision_pc.core.odometry.pose_spread import AccumulatedError
from vision_pc.core.odometry.relocalisation import relocalised
from vision_pc.core.odometry.shared_offset import SharedOffset
from vision_pc.core.odometry.tracking import Flags, is_noisy, smoothed
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, OdometryPose, PointPairs, StereoPair

_TRIES = 3  # keyframes to try before a frame is lost
_TOOL_MOVED = 2e-3  # m or rad
_DARK = 8.0  # mean grey level below which the light is too poor
_DARK_STEP = 8  # px between the pixels that are asked


class _Mask(NamedTuple):
    """Where each eye may see the static world (height, width), for a tool marker at ``X_CM``; None: none."""

    left: Flags
    right: Flags
    X_CM: Array | None = None


class StereoOdometry:
    """Follows the camera from pair to pair; C0 is the camera of the first pair that could be used.

    ``camera`` should have the right eye's offset put in (``intrinsics.with_offset``): a disparity error
    bends and scales the path. What moves with the camera is left out by ``tool`` and the tool marker's
    pose, once one was given. ``offset`` learns how far the eyes' columns are off. ``doubted``: something was
    seen to move before, and nothing told which of it the world is.
    """

    def __init__(
        self,
        camera: CameraCalibration,
        settings: OdometrySettings,
        tool: ToolMarkerSettings | None = None,
        doubted: bool = False,
        offset: SharedOffset | None = None,
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._tool = tool
        self._map = KeyframeMap(camera, settings.depth_floor_px)
        self._localiser = Localiser(camera, settings, self._map, doubted)
        self._mapper = Mapper(camera, settings, self._map, offset or SharedOffset(learns=False))
        self._error = AccumulatedError(settings.disparity_std_px)
        self._history = History(settings.lever_m)
        self._X_C0C = se3.identity()
        self._motion = se3.identity()
        everything = np.ones((camera.height, camera.width), dtype=bool)
        self._static = _Mask(everything, everything)
        self._smooths = self._other_light = False  # pictures are noisy; lit otherwise than keyframes were
        self._lost_frames = self._frames = 0
        self.trust = MapTrust(doubted)
        self.last_loss: str | None = None
        self.last_detail: str | None = None

    @property
    def keyframes(self) -> int:
        """How many keyframes the map holds."""
        return len(self._map.keyframes)

    @property
    def is_undecided(self) -> bool:
        """Whether the last pair was lost because two motions have not gone far enough apart yet."""
        return self.last_loss is not None and f"{self.last_loss}: {self.last_detail}" == UNDECIDED

    def process(
        self, pair: StereoPair, X_CM: Array | None = None, X_BT: Array | None = None
    ) -> OdometryPose | None:
        """The camera's pose at ``pair``, or None when it is lost; then ``last_loss`` names the cause.

        ``X_CM``: the tool marker as seen in this pair, to keep the tool out of the static world; the last
        one holds. ``X_BT``: where the arm's own state has the tool, which tells the camera's motion from that
        of what moves before it. Causes: ``too_dark``, ``no_texture``, ``too_few_points``, ``poor_coverage``,
        ``two_motions``, ``sudden_motion``, ``bad_rectification``, ``swapped_eyes``; ``last_detail`` has the
        figure of the last two.
        """
        if X_CM is not None and self._tool is not None and self._has_moved(X_CM):
            self._static = _Mask(*static_pixels(X_CM, self._tool, self._camera), X_CM)
        if not self._map.keyframes:
            self._smooths = is_noisy(pair.left)  # once for the whole map: patches are compared across frames
        used = smoothed(pair) if self._smooths else pair
        frame = Frame(used, tracking.halved(used.left), self._static.left, self._static.right)
        next_keyframe = self._map.next_number
        outcome = (
            self._localise(frame, self._history.foreseen(X_BT))
            if self._map.keyframes
            else self._mapper.begin(frame, self._X_C0C)
        )
        self._frames += 1
        outcome = self._judged(pair, outcome, X_BT is not None)
        if isinstance(outcome, str):
            self._lose(pair, outcome)
            return None
        self._motion = se3.identity() if self._lost_frames else se3.inverse(self._X_C0C) @ outcome.X_C0C
        points = self._map.points[outcome.ids]
        self._history.found(outcome.X_C0C, X_BT, self._camera, points, outcome.pixels)
        self._X_C0C = outcome.X_C0C
        self.trust.located()
        self._lost_frames = 0
        self.last_loss = self.last_detail = None
        made = next_keyframe if self._map.next_number > next_keyframe else None
        return self._pose_of(pair, outcome, self._error.after(outcome.X_C0C, outcome.spread, made))

    def _judged(self, pair: StereoPair, outcome: PoseEstimate | str, arm_known: bool) -> PoseEstimate | str:
        """``outcome``, or ``two_motions`` where what moved may be all that the map shows."""
        if arm_known:
            located, since = isinstance(outcome, PoseEstimate), self._localiser.mixed_since
            self.trust.checked(pair.capture_ns, self._map.next_number, since, located)
            return outcome
        if isinstance(outcome, PoseEstimate) and len(outcome.moving) and self.trust.is_doubtful:
            outcome = "two_motions"
        if outcome == "two_motions":
            self.trust.unresolved()
        return outcome

    def _pose_of(self, pair: StereoPair, found: PoseEstimate, covariance: Array) -> OdometryPose:
        """What is reported of ``pair``, located as ``found``."""
        cells = tracking.grid_cells(found.pixels, pair.left.shape)
        return OdometryPose(
            pair.capture_ns,
            pair.frame_id,
            found.X_C0C,
            covariance,
            len(found.ids),
            float(cells.mean()),
            found.residual_px,
            self._pairs(found),
        )

    def _lose(self, pair: StereoPair, why: str) -> None:
        """Keep in mind that ``pair`` could not be used."""
        dark = float(pair.left[::_DARK_STEP, ::_DARK_STEP].mean()) < _DARK
        cause, _, detail = why.partition(": ")
        self.last_loss, self.last_detail = ("too_dark", None) if dark else (cause, detail or None)
        self._motion = se3.identity()
        self._lost_frames += 1
        self._history.lost()

    def _pairs(self, found: PoseEstimate) -> PointPairs:
        """The points of ``found`` that both eyes see."""
        both = found.seen_right
        right = intrinsics.distorted(self._camera.right, found.right_rays[both])
        return PointPairs(found.pixels[both], right)

    def _has_moved(self, X_CM: Array) -> bool:
        """Whether the tool is elsewhere in the picture than where it was last left out."""
        before = self._static.X_CM
        return before is None or bool(np.linalg.norm(se3.local(before, X_CM)) > _TOOL_MOVED)

    def _localise(self, frame: Frame, foreseen: Foreseen) -> PoseEstimate | str:
        """The pose against the most similar keyframes: from the expected motion on, from none, in another
        light, or from nowhere.
        """
        moved = self._X_C0C @ self._motion
        found = self._in_other_light(frame, moved, foreseen) if self._other_light else None
        if found is not None:
            return found
        outcome: PoseEstimate | str = "too_few_points"
        at_rest = np.array_equal(self._motion, se3.identity())
        for expected in (self._X_C0C,) if at_rest else (moved, self._X_C0C):
            for keyframe in self._map.nearest(expected)[:_TRIES]:
                outcome = self._localiser.localise(frame, keyframe, expected, self._both_eyes(), foreseen)
                if outcome in ("two_motions", "sudden_motion", UNDECIDED) and foreseen.known:
                    return outcome  # another start would only let the other motion win
                if isinstance(outcome, PoseEstimate):
                    return self._kept_up(frame, keyframe, outcome, foreseen)
        found = self._in_other_light(frame, moved, foreseen)
        return self._from_nowhere(frame, foreseen, outcome) if found is None else found

    def _in_other_light(self, frame: Frame, expected: Array, foreseen: Foreseen) -> PoseEstimate | str | None:
        """The pose by what a shadow does not change; None where that finds none that can be believed."""
        for keyframe in self._map.nearest(expected)[:_TRIES]:
            outcome = self._localiser.localise(
                frame, keyframe, expected, self._both_eyes(), foreseen, other_light=True
            )
            if isinstance(outcome, PoseEstimate):
                self._other_light = True
                return self._kept_up(frame, keyframe, outcome, foreseen)
        self._other_light = False
        return None

    def _from_nowhere(
        self, frame: Frame, foreseen: Foreseen, otherwise: PoseEstimate | str
    ) -> PoseEstimate | str:
        """The pose with no idea of it, by one keyframe's descriptors; ``otherwise`` where they find none."""
        keyframe = self._map.keyframes[
            self._lost_frames % len(self._map.keyframes)
        ]  # a different one each time
        found = relocalised(frame.pair.left, frame.left_static, keyframe, self._camera)
        if found is None:
            return otherwise
        outcome = self._localiser.localise(frame, keyframe, found, both_eyes=True, foreseen=foreseen)
        return (
            self._kept_up(frame, keyframe, outcome, foreseen)
            if isinstance(outcome, PoseEstimate)
            else outcome
        )

    def _kept_up(
        self, frame: Frame, keyframe: Keyframe, found: PoseEstimate, foreseen: Foreseen
    ) -> PoseEstimate | str:
        """``found``, with a new keyframe where few of ``keyframe``'s points are left in view. Those that a
        shadow hides are not gone: each new keyframe stands where few points hold it, and the path with it.
        """
        needed = self._settings.keyframe_overlap * len(keyframe.ids)
        if len(found.ids) < needed and not self._other_light:
            shaded = self._localiser.localise(
                frame, keyframe, found.X_C0C, self._both_eyes(), foreseen, other_light=True
            )
            if isinstance(shaded, PoseEstimate) and len(shaded.ids) > len(found.ids):
                found, self._other_light = shaded, True
        return self._add_keyframe(frame, keyframe, found) if len(found.ids) < needed else found

    def _both_eyes(self) -> bool:
        """Whether the right eye's turn has come."""
        every = self._settings.right_every
        return every > 0 and self._frames % every == 0

    def _add_keyframe(self, frame: Frame, keyframe: Keyframe, estimate: PoseEstimate) -> PoseEstimate | str:
        """The pose with a new keyframe made, which takes both eyes, and has the light of now."""
        other_light, self._other_light = self._other_light, False
        if not estimate.seen_right.any():
            both = self._localiser.localise(
                frame, keyframe, estimate.X_C0C, both_eyes=True, other_light=other_light
            )
            if isinstance(both, str):
                return both
            estimate = both
        return self._mapper.extend(frame, estimate)
