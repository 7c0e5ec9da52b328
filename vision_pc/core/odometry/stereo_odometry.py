"""The camera's path in a static world, from stereo pairs against a persistent map of keyframes."""

import numpy as np

from vision_pc.config.vision import OdometrySettings, ToolMarkerSettings
from vision_pc.core import se3
from vision_pc.core.odometry import tracking
from vision_pc.core.odometry.arm_prior import ArmHistory, ArmPrior
from vision_pc.core.odometry.frame import Frame, PoseEstimate
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.odometry.localisation import Localiser
from vision_pc.core.odometry.mapping import Mapper
from vision_pc.core.odometry.moving_regions import static_pixels
from vision_pc.core.odometry.pose_spread import AccumulatedError
from vision_pc.core.odometry.relocalisation import relocalised
from vision_pc.core.odometry.shared_offset import SharedOffset
from vision_pc.core.odometry.tracking import is_noisy, smoothed
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, OdometryPose, PointPairs, StereoPair

_WITH_A_MOVER = 0.5  # [D]
_TRIES = 3  # keyframes to try before a frame is lost
_TOOL_MOVED = 2e-3  # m or rad
_DARK = 8.0  # mean grey level below which the light is too poor
_DARK_STEP = 8  # px between the pixels that are looked at


class StereoOdometry:
    """Follows the camera from pair to pair; C0 is the camera of the first pair that could be used.

    ``camera`` should have the right eye's offset put in (``intrinsics.with_offset``): a disparity error
    bends and scales the path. What moves with the camera is left out by ``tool`` and the tool marker's
    pose, once one was given. ``offset`` learns how far the eyes' columns are off.
    """

    def __init__(
        self,
        camera: CameraCalibration,
        settings: OdometrySettings,
        tool: ToolMarkerSettings | None = None,
        offset: SharedOffset | None = None,
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._tool = tool
        self._map = KeyframeMap(camera, settings.depth_floor_px)
        self._localiser = Localiser(camera, self._map, offset or SharedOffset(learns=False))
        self._mapper = Mapper(camera, settings, self._map)
        self._error = AccumulatedError(settings.disparity_std_px)
        self._arm = ArmHistory(settings.lever_m)
        self._X_C0C, self._motion = se3.identity(), se3.identity()
        everything = np.ones((camera.height, camera.width), dtype=bool)
        self._static = (everything, everything)
        self._X_CM: Array | None = None  # of the tool that is left out there
        self._smooths = False  # pictures are noisy
        self._lost_frames = 0
        self.last_loss: str | None = None
        self.last_detail: str | None = None

    @property
    def keyframes(self) -> int:
        """How many keyframes the map holds."""
        return len(self._map.keyframes)

    def process(
        self, pair: StereoPair, X_CM: Array | None = None, X_BT: Array | None = None
    ) -> OdometryPose | None:
        """The camera's pose at ``pair``, or None when it is lost; then ``last_loss`` names the cause.

        ``X_CM``: the tool marker as seen in this pair, to keep the tool out of the static world; the last
        one holds. ``X_BT``: where the arm's own state has the tool, which tells the camera's motion from that
        of what moves before it. Causes: ``too_dark``, ``no_texture``, ``too_few_points``, ``poor_coverage``,
        ``two_motions``, ``sudden_motion``, ``bad_rectification``, ``swapped_eyes``; ``last_detail`` has the
        figure, where there is one.
        """
        self._leave_out(X_CM)
        if not self._map.keyframes:
            self._smooths = is_noisy(pair.left)  # once for the whole map: patches are compared across frames
        used = smoothed(pair) if self._smooths else pair
        frame = Frame(used, tracking.halved(used.left), *self._static)
        next_keyframe = self._map.next_number
        outcome = (
            self._localise(frame, self._arm.prior(X_BT))
            if self._map.keyframes
            else self._mapper.begin(frame, self._X_C0C)
        )
        if isinstance(outcome, str):
            self._lose(pair, outcome)
            return None
        self._motion = se3.identity() if self._lost_frames else se3.inverse(self._X_C0C) @ outcome.X_C0C
        self._arm.found(outcome.X_C0C, X_BT)
        self._X_C0C, self._lost_frames = outcome.X_C0C, 0
        self.last_loss = self.last_detail = None
        made = next_keyframe if self._map.next_number > next_keyframe else None
        return self._pose_of(pair, outcome, self._error.after(outcome.X_C0C, outcome.spread, made))

    def _leave_out(self, X_CM: Array | None) -> None:
        """Keep the tool out of the static world, where it is elsewhere in the picture than before."""
        if X_CM is None or self._tool is None:
            return
        if self._X_CM is None or np.linalg.norm(se3.local(self._X_CM, X_CM)) > _TOOL_MOVED:
            self._static, self._X_CM = static_pixels(X_CM, self._tool, self._camera), X_CM

    def _pose_of(self, pair: StereoPair, found: PoseEstimate, covariance: Array) -> OdometryPose:
        """What is reported of ``pair``, located as ``found``."""
        both = found.seen_right
        right = intrinsics.distorted(self._camera.right, found.right_rays[both])
        return OdometryPose(
            pair.capture_ns,
            pair.frame_id,
            found.X_C0C,
            covariance,
            len(found.ids),
            float(tracking.grid_cells(found.pixels, pair.left.shape).mean()),
            found.residual_px,
            PointPairs(found.pixels[both], right),
        )

    def _lose(self, pair: StereoPair, why: str) -> None:
        """Keep in mind that ``pair`` could not be used."""
        dark = float(pair.left[::_DARK_STEP, ::_DARK_STEP].mean()) < _DARK
        cause, _, detail = why.partition(": ")
        self.last_loss, self.last_detail = ("too_dark", None) if dark else (cause, detail or None)
        self._motion = se3.identity()
        self._lost_frames += 1

    def _localise(self, frame: Frame, arm: ArmPrior | None) -> PoseEstimate | str:
        """The pose against the most similar keyframes: from the expected motion on, from none, or from
        nowhere.
        """
        outcome: PoseEstimate | str = "too_few_points"
        at_rest = np.array_equal(self._motion, se3.identity())
        for expected in [self._X_C0C] if at_rest else [self._X_C0C @ self._motion, self._X_C0C]:
            for keyframe in self._map.nearest(expected)[:_TRIES]:
                outcome = self._localiser.localise(frame, keyframe, expected, arm)
                if isinstance(outcome, PoseEstimate):
                    return self._extended(frame, keyframe, outcome)
                if outcome.startswith(("two_motions", "sudden_motion")):
                    return outcome  # another start would only let the other motion win
        keyframe = self._map.keyframes[self._lost_frames % self.keyframes]  # a different one each time
        nowhere = relocalised(frame.pair.left, frame.left_static, keyframe, self._camera)
        if nowhere is None:
            return outcome
        outcome = self._localiser.localise(frame, keyframe, nowhere, arm)
        return outcome if isinstance(outcome, str) else self._extended(frame, keyframe, outcome)

    def _extended(self, frame: Frame, keyframe: Keyframe, found: PoseEstimate) -> PoseEstimate:
        """``found``; the frame becomes a keyframe where few of ``keyframe``'s points are in view: fewer where
        something moves, which would come into the map.
        """
        overlap = self._settings.keyframe_overlap * (_WITH_A_MOVER if found.by_arm else 1.0)
        if len(found.ids) < overlap * len(keyframe.ids):
            self._mapper.extend(frame, found)
        return found
