"""What a request may say of a program, and the settings that it is laid over.

A member that is left out is as configured. Lengths of a few millimetres are asked for in mm: such a member
gives the settings' field in m.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from foundation.configuration import StrictModel
from vision_pc.config.choices import PositioningMethod
from vision_pc.config.programs import (
    Association,
    CircleMinimum,
    MatchedTraces,
    OrientationForm,
    OrientationSettings,
    PathPlacement,
    PositioningSettings,
    VisualServoingSettings,
)

Metres = Annotated[float, Field(ge=-10.0, le=10.0)]
Vector = tuple[Metres, Metres, Metres]
Unit = Annotated[float, Field(ge=-1.001, le=1.001)]
Clearance = Annotated[float, Field(ge=0.0, le=1.0)]
Length = Annotated[float, Field(ge=0.01, le=1.5)]
Target = Annotated[
    str,
    Field(
        max_length=20,
        description="Of `/targets`, or `markers`: it is aimed at from then on. Left out: what is aimed at,"
        " which another client may have changed just now",
    ),
]


class RequestBody(StrictModel):
    """Base of request bodies, as strict as the configuration; None means as configured."""

    def overrides(self) -> dict[str, Any]:
        """The members that were given, as fields of the settings."""
        given = self.model_dump(exclude_none=True)
        lengths = {name: given.pop(name) for name in list(given) if name.endswith("_mm")}
        return given | {name.removesuffix("mm") + "m": 1e-3 * value for name, value in lengths.items()}


class LookBody(RequestBody):
    """A look: ``frames`` pairs with the arm at rest."""

    frames: int | None = Field(None, ge=1, le=100, examples=[10])


class TurnSettings(OrientationSettings):
    """Orientation adjustment, and parallel to which target (None: as aimed)."""

    target: str | None = None


class OrientationBody(RequestBody):
    """Orientation adjustment (7)(8)."""

    form: OrientationForm | None = Field(None, examples=["frame_true"])
    repetitions: int | None = Field(None, ge=1, le=5, examples=[1])
    limit_deg: float | None = Field(None, gt=0.0, le=90.0)
    target: Target | None = Field(None, examples=[None])


class LineEquationBody(RequestBody):
    """Line equation (10)-(16): circle and one input."""

    radius_m: float | None = Field(None, ge=0.02, le=0.6, examples=[0.2])
    points: int | None = Field(None, ge=6, le=24, examples=[18])
    minimum: CircleMinimum | None = None


class TrajectoryBody(RequestBody):
    """Trajectory matching (17)-(19) and the match."""

    segments_m: tuple[Length, ...] | None = Field(
        None, min_length=2, max_length=23, examples=[[0.30, 0.10, 0.05, 0.30]]
    )
    turn_deg: float | None = Field(None, ge=5.0, le=175.0)
    heading_deg: float | None = Field(None, ge=-180.0, le=180.0)
    placement: PathPlacement | None = None
    method: MatchedTraces | None = None
    association: Association | None = None


class LocalTrackBody(RequestBody):
    """Three legs along the tool's axes, for the corrected look-then-move."""

    leg_m: float | None = Field(None, ge=0.05, le=0.5, examples=[0.2])


class LookThenMoveSettings(PositioningSettings):
    """Look-then-move, by which calibration, and to which target (None: as aimed)."""

    method: PositioningMethod = PositioningMethod.CORRECTED
    target: str | None = None


class ApproachBody(RequestBody):
    """How a target is driven to."""

    clearance_m: Clearance | None = Field(None, examples=[0.1])
    tolerance_mm: float | None = Field(None, gt=0.0, le=100.0, examples=[5.0])
    corrections: int | None = Field(
        None, ge=0, le=10, description="Of `corrected`: motions by odometry alone; 0: one shot"
    )


class LookThenMoveBody(ApproachBody):
    """Look-then-move (20)-(22). ``method``: by the local track, corrected by odometry on the way, or the
    paper's, by trajectory matching.
    """

    method: Literal["corrected", "paper"] = "corrected"
    target: Target | None = Field(None, examples=[None])
    inputs: int | None = Field(
        None,
        ge=1,
        le=10,
        description="Of `paper`: looks and steps; `corrected` is one look, ask again for another",
    )
    aim_mm: float | None = Field(None, ge=0.0, le=100.0, description="No input below this; 0: always one")

    @model_validator(mode="after")
    def _of_the_method(self) -> "LookThenMoveBody":
        other = {"corrected": ("inputs", "paper"), "paper": ("corrections", "corrected")}
        member, method = other[self.method]
        if getattr(self, member) is not None:
            raise ValueError(f"{member} = {getattr(self, member)} is of method {method}, not {self.method}")
        return self


class ServoingSettings(VisualServoingSettings):
    """Visual servoing, the distance to the object that it shall leave, and which target (None: as aimed)."""

    target: str | None = None
    clearance_m: Clearance


class LookingAndMovingBody(RequestBody):
    """Looking and moving: closed loop at camera rate. Settings left out are as configured."""

    gain: float | None = Field(None, gt=0.0, le=1.0, examples=[0.5])
    pull_gain: float | None = Field(None, ge=0.0, le=1.0)
    clearance_m: Clearance | None = Field(None, examples=[0.1])
    settle_mm: float | None = Field(None, gt=0.0, le=50.0, examples=[1.0])
    timeout_s: float | None = Field(None, gt=0.0, le=600.0)
    target: Target | None = Field(None, examples=[None])

    def overrides(self) -> dict[str, Any]:
        """As given; a settling limit that was asked for is not widened."""
        return super().overrides() | ({} if self.settle_mm is None else {"wanted_m": 0.0})


class PoseBody(RequestBody):
    """A pose in B."""

    p_m: Vector = Field(examples=[[3.9, 0.0, 1.0]])
    q_wxyz: tuple[Unit, Unit, Unit, Unit] = Field(examples=[[0.5, -0.5, 0.5, -0.5]])

    @model_validator(mode="after")
    def _unit(self) -> "PoseBody":
        norm = math.sqrt(sum(c * c for c in self.q_wxyz))
        if abs(norm - 1.0) > 1e-3:
            raise ValueError(f"q_wxyz has norm {norm:.4f}, must be 1 within 0.001")
        return self


class HomeBody(RequestBody):
    """The way back: ``duration_s`` 0 takes the time that the controller's limits ask for."""

    duration_s: float = Field(0.0, ge=0.0, le=60.0)


class MoveBody(RequestBody):
    """A point-to-point motion: to ``X_BT``, or by an offset along the axes of base or tool (just one)."""

    X_BT: PoseBody | None = None
    offset_base_m: Vector | None = None
    offset_tool_m: Vector | None = Field(None, examples=[[0.05, 0.0, 0.0]])
    duration_s: float = Field(0.0, ge=0.0, le=60.0)

    @model_validator(mode="after")
    def _one_target(self) -> "MoveBody":
        if sum(t is not None for t in (self.X_BT, self.offset_base_m, self.offset_tool_m)) != 1:
            raise ValueError("exactly one of X_BT, offset_base_m and offset_tool_m is wanted")
        return self
