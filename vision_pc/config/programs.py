"""Settings of the calibration and positioning programs: section ``programs`` of ``vision.yaml``."""

from typing import Annotated, Literal

from pydantic import Field

from foundation.configuration import StrictModel

# Relative: a hole whose diameter is so near to what is asked for counts.
_DIAMETER_TOLERANCE = 0.15  # [M] at 2 m a hole of 45 mm is measured as 43.5 ± 0.5 mm


class TargetSettings(StrictModel):
    """How wide drill holes are."""

    diameter_mm: float = Field(45.0, gt=5.0, le=500.0)

    def diameters_m(self, diameter_mm: float | None) -> tuple[float, float]:
        """The least and the greatest diameter of a hole of ``diameter_mm`` (None: as configured)."""
        wanted = 1e-3 * (self.diameter_mm if diameter_mm is None else diameter_mm)
        return wanted * (1.0 - _DIAMETER_TOLERANCE), wanted * (1.0 + _DIAMETER_TOLERANCE)


Length = Annotated[float, Field(ge=0.01, le=1.5)]
Small = Annotated[float, Field(gt=0.0, le=0.1)]
Seconds = Annotated[float, Field(ge=0.0, le=60.0)]


OrientationForm = Literal["frame_true", "paper"]
"""The turn of (7)(8) taken at the marker: right for any camera mount; or as printed."""


class OrientationSettings(StrictModel):
    """Orientation adjustment (7)(8)."""

    form: OrientationForm = Field(examples=["frame_true"])
    repetitions: int = Field(ge=1, le=5, examples=[1])
    limit_deg: float = Field(gt=0.0, le=90.0)


class LineEquationSettings(StrictModel):
    """Line equation (10)-(16).

    ``minimum``: the least sample as printed, or a fit through all of them.
    """

    radius_m: float = Field(ge=0.02, le=0.6, examples=[0.2])
    points: int = Field(ge=6, le=24, examples=[18])
    segment_s: Seconds
    minimum: Literal["sample", "fit"]
    seen_share: float = Field(gt=0.0, le=1.0)
    step_limit_m: float = Field(gt=0.0, le=5.0)


class TrajectorySettings(StrictModel):
    """Trajectory matching (17)-(19) and the match.

    ``heading_deg`` turns the whole path in the n-s plane; ``turn_deg`` is the paper's π/4. ``placement``:
    where the arm stands on the path: at its end, so that the object is in view again, or at its start.
    ``method``: the marker's positions, the lever arm removed, or the camera's poses as in the paper.
    ``association``: whether the samples of both traces belong together by their time.
    """

    segments_m: tuple[Length, ...] = Field(min_length=2, max_length=23, examples=[[0.30, 0.10, 0.05, 0.30]])
    turn_deg: float = Field(ge=5.0, le=175.0)
    heading_deg: float = Field(ge=-180.0, le=180.0)
    placement: Literal["ends_here", "starts_here"]
    segment_s: Seconds
    dwell_s: Seconds
    method: Literal["points", "paper"]
    association: Literal["time", "none"]
    minimum_samples: int = Field(ge=8, le=10_000)
    condition_limit: float = Field(ge=1.0)


class TakeUpSettings(StrictModel):
    """Short turns of slew, lift and tilt that end every motion on the same side of their backlash.

    ``slew_rad`` within ``duration_s``, ``boom_rad`` of lift and tilt. A residual beyond ``residual_rad`` is
    more than the servo leaves of a joint.
    """

    slew_rad: float = Field(ge=0.0, le=0.02)
    boom_rad: float = Field(ge=0.0, le=0.02)
    duration_s: Seconds
    residual_rad: float = Field(gt=0.0, le=0.01)


class LocalErrorModelSettings(StrictModel):
    """Three legs along n, s and a, a local error model, and corrections by odometry.

    Priors of the model: ``rotation_std`` (rad), ``strain_std`` (relative), ``play_std`` (rad).
    ``noise_std_m`` of one sample at rest, ``sway_s`` metres more for every m/s. ``goal_std_limit_m``: a goal
    known worse is refused before moving. A way longer than ``near_m`` is not driven at once.
    ``odometry_std_m`` and ``odometry_scale_std`` (relative): of the way that odometry measures.
    ``servo_std_m``: what the joints leave of a motion. ``leg_end_std_m``: what else than backlash shaped each
    end of a leg, of a motion that nothing corrects.
    """

    leg_m: float = Field(ge=0.05, le=0.5, examples=[0.2])
    segment_s: Seconds
    dwell_s: Seconds
    rotation_std: float = Field(gt=0.0, le=1.0)
    strain_std: float = Field(gt=0.0, le=0.2)
    play_std: Small
    take_up: TakeUpSettings
    noise_std_m: float = Field(gt=0.0, le=0.05)
    sway_s: float = Field(ge=0.0, le=1.0)
    odometry_std_m: float = Field(ge=0.0, le=0.05)
    odometry_scale_std: float = Field(ge=0.0, le=0.1)
    servo_std_m: float = Field(gt=0.0, le=0.05)
    leg_end_std_m: float = Field(ge=0.0, le=0.05)
    goal_std_limit_m: float = Field(gt=0.0, le=1.0)
    near_m: float = Field(ge=0.0, le=1.0)


class PositioningSettings(StrictModel):
    """Look-then-move (20)-(22). ``servo_std_m`` and ``strain_std`` (per metre that the step goes along each
    axis of the camera) are what a rotation alone cannot know.

    ``corrections``: motions after the first one that the corrected form may make by odometry alone; none: one
    open-loop step. They follow while odometry's error exceeds ``nudge_m`` and another one is worth it;
    ``outside`` more while odometry sees the tool outside half of the tolerance.
    An error below ``aim_m`` in x and y and ``depth_aim_m`` in z is left alone: play and stiction make a
    smaller step a gamble. ``axis_std_rad``: how far the camera's axis is off where its calibration has it,
    the principal point's error over the focal length; 0: it is there.
    """

    clearance_m: float = Field(ge=0.0, le=1.0, examples=[0.1])
    tolerance_m: float = Field(gt=0.0, le=0.1, examples=[0.005])
    aim_m: float = Field(ge=0.0, le=0.1, description="No input below this; 0: always one")
    depth_aim_m: float = Field(ge=0.0, le=0.5)
    inputs: int = Field(
        ge=1,
        le=10,
        description="Of `paper`: looks and steps; `corrected` is one look, ask again for another",
    )
    step_limit_m: float = Field(gt=0.0, le=5.0)
    duration_s: Seconds
    strain_std: float = Field(ge=0.0, le=0.2)
    servo_std_m: float = Field(ge=0.0, le=0.05)
    corrections: int = Field(
        ge=0, le=10, description="Of `corrected`: motions by odometry alone; 0: one shot"
    )
    outside: int = Field(ge=0, le=10)
    nudge_m: float = Field(gt=0.0, le=0.1)
    axis_std_rad: float = Field(ge=0.0, le=0.1)


class VisualServoingSettings(StrictModel):
    """Looking and moving: closed loop at camera rate.

    ``gain``: share of a picture's news that the target takes, farther than ``near_m`` from the object;
    ``pull_gain``: share of the remaining error that it takes whenever the tool rests. Either is ``step_m`` at
    most. At rest: over ``settle_pictures`` the error neither spread nor changed, and the encoders are within
    ``servo_gap_m`` of what is commanded; settled: its mean is also inside ``settle_m`` in x and y. After a
    rest outside, an end is good that is within ``wanted_m`` in 19 of 20 cases.
    """

    gain: float = Field(gt=0.0, le=1.0, examples=[0.5])
    pull_gain: float = Field(ge=0.0, le=1.0)
    step_m: float = Field(gt=0.0, le=0.5)
    near_m: float = Field(ge=0.0, le=0.2)
    lead_m: float = Field(gt=0.0, le=0.4)
    settle_m: float = Field(gt=0.0, le=0.05, examples=[0.001])
    wanted_m: float = Field(ge=0.0, le=0.05)
    servo_gap_m: float = Field(gt=0.0, le=0.1)
    settle_pictures: int = Field(ge=4, le=200)
    timeout_s: float = Field(gt=0.0, le=600.0)
    step_limit_m: float = Field(gt=0.0, le=5.0)


class ProgramSettings(StrictModel):
    """All programs' settings."""

    orientation: OrientationSettings
    line_equation: LineEquationSettings
    trajectory: TrajectorySettings
    local_map: LocalErrorModelSettings
    positioning: PositioningSettings
    looking_and_moving: VisualServoingSettings
