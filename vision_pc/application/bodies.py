"""What a request may say of a program: its settings' own fields, made optional, with the settings' ranges.

A body lays what was given over the settings as configured. Lengths of a few millimetres are asked for in mm:
that is stated once, in ``_UNITS``.
"""

import math
from collections.abc import Mapping
from dataclasses import astuple
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel, ConfigDict, Field, create_model, model_validator
from pydantic.fields import FieldInfo

from vision_pc.config.choices import PositioningMethod
from vision_pc.config.programs import (
    LineEquationSettings,
    LocalErrorModelSettings,
    OrientationSettings,
    PositioningSettings,
    TrajectorySettings,
    VisualServoingSettings,
)

_UNITS = {"_mm": ("_m", 1e-3)}
"""Suffix of a member → suffix of the settings' field, and one unit of the member in the field's unit."""
Metres = Annotated[float, Field(ge=-10.0, le=10.0)]
Vector = tuple[Metres, Metres, Metres]
Unit = Annotated[float, Field(ge=-1.001, le=1.001)]


class Copied(NamedTuple):
    """The settings' field of a member, one unit of the member in the field's, and what else it sets."""

    field: str
    scale: float | None
    also: dict[str, Any]


class RequestBody(BaseModel):
    """Base of request bodies: unknown members, NaN and infinity are refused; None means as configured.

    ``copied``: for each member that copies a settings' field under another unit or sets more than it.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    copied: ClassVar[dict[str, Copied]] = {}

    def overrides(self) -> dict[str, Any]:
        """The members that were given, as fields of the settings."""
        laid: dict[str, Any] = {}
        for name, value in self.model_dump(exclude_none=True).items():
            copied = self.copied.get(name, Copied(name, None, {}))
            laid[copied.field] = value if copied.scale is None else copied.scale * value
            laid |= copied.also
        return laid


class Copy(NamedTuple):
    """A settings' field that a request may give; ``also``: settings that go with it when it is given."""

    example: Any = None
    description: str | None = None
    also: Mapping[str, Any] = MappingProxyType({})


class Own(NamedTuple):
    """A member that copies no field of the settings: its type, and pydantic's field."""

    type: Any
    field: Any


def body_of(name: str, doc: str, settings: type[BaseModel], /, **members: Any) -> type[RequestBody]:
    """The body ``name``, its members in this order.

    A member copies the field of ``settings`` of its name, made optional, with the field's limits; what is
    given for it is its example (None: without one), or a ``Copy`` that says more. Or it is an ``Own``.
    """
    fields: dict[str, Any] = {}
    copied: dict[str, Copied] = {}
    for member, said in members.items():
        if isinstance(said, Own):
            fields[member] = (said.type, said.field)
            continue
        copy = said if isinstance(said, Copy) else Copy(said)
        field, scale = _origin(member, settings)
        copied[member] = Copied(field, scale, dict(copy.also))
        examples = None if copy.example is None else [copy.example]
        optional = _optional(settings.model_fields[field], scale)
        fields[member] = (optional, Field(None, examples=examples, description=copy.description))
    made: type[RequestBody] = create_model(name, __base__=RequestBody, __doc__=doc, **fields)
    made.copied = copied
    return made


def _origin(member: str, settings: type[BaseModel]) -> tuple[str, float | None]:
    """The settings' field that ``member`` copies, and one unit of the member in its unit if they differ."""
    if member in settings.model_fields:
        return member, None
    for suffix, (within, scale) in _UNITS.items():
        field = member.removesuffix(suffix) + within
        if member.endswith(suffix) and field in settings.model_fields:
            return field, scale
    raise KeyError(f"{settings.__name__} has no field for {member}")


def _optional(field: FieldInfo, scale: float | None) -> Any:
    """The field's type and limits in the member's unit, or None; an enum as its values, written in place."""
    type_: Any = field.annotation
    if isinstance(type_, type) and issubclass(type_, StrEnum):
        type_ = Literal[tuple(member.value for member in type_)]
    for limit in field.metadata:
        type_ = Annotated[type_, limit if scale is None else _in_unit(limit, scale)]
    return type_ | None


def _in_unit(limit: Any, scale: float) -> Any:
    """A number's bound in the member's unit. Raises TypeError for another constraint."""
    if not isinstance(limit, Gt | Ge | Lt | Le):
        raise TypeError(f"{limit} is no bound of a number")
    (bound,) = astuple(limit)
    return type(limit)(round(bound / scale, 9))


class LookBody(RequestBody):
    """A look: ``frames`` pairs with the arm at rest."""

    # Its own: a request's look is shorter than the section ``look`` of vision.yaml allows.
    frames: int | None = Field(None, ge=1, le=100, examples=[10])


class ValveTrialsBody(RequestBody):
    """Valves are tried out blindly: say that the tool is empty and nobody is within reach of the arm."""

    confirmed: Literal[True] = Field(examples=[True])


_TARGET = Own(
    str | None,
    Field(
        None,
        max_length=20,
        description="Of `/targets`, or `markers`: it is aimed at from then on. Left out: what is aimed at,"
        " which another client may have changed just now",
        examples=[None],
    ),
)


class TurnSettings(OrientationSettings):
    """Orientation adjustment, and parallel to which target (None: as aimed)."""

    target: str | None = None


OrientationBody = body_of(
    "OrientationBody", "Orientation adjustment (7)(8).", TurnSettings,
    form="frame_true", repetitions=1, limit_deg=None, target=_TARGET,
)  # fmt: skip
LineEquationBody = body_of(
    "LineEquationBody", "Line equation (10)-(16): circle and one input.", LineEquationSettings,
    radius_m=0.2, points=18, minimum=None,
)  # fmt: skip
TrajectoryBody = body_of(
    "TrajectoryBody", "Trajectory matching (17)-(19) and the match.", TrajectorySettings,
    segments_m=[0.30, 0.10, 0.05, 0.30], turn_deg=None, heading_deg=None, placement=None, method=None,
    association=None,
)  # fmt: skip
LocalTrackBody = body_of(
    "LocalTrackBody",
    "Three legs along the tool's axes, for the corrected look-then-move.",
    LocalErrorModelSettings,
    leg_m=0.2,
)  # fmt: skip


class LookThenMoveSettings(PositioningSettings):
    """Look-then-move, by which calibration, and to which target (None: as aimed)."""

    method: PositioningMethod = PositioningMethod.CORRECTED
    target: str | None = None


_LookThenMove = body_of(
    "LookThenMoveBody",
    "",
    LookThenMoveSettings,
    # Its own: it has a default, because no configuration chooses it.
    method=Own(Literal["corrected", "paper"], "corrected"),
    target=_TARGET,
    inputs=Copy(description="Of `paper`: looks and steps; `corrected` is one look, ask again for another"),
    clearance_m=0.1,
    tolerance_mm=5.0,
    aim_mm=Copy(description="No input below this; 0: always one"),
    corrections=Copy(description="Of `corrected`: motions by odometry alone; 0: one shot"),
)


class LookThenMoveBody(_LookThenMove):  # type: ignore[misc, valid-type]
    """Look-then-move (20)-(22). ``method``: by the local track, corrected by odometry on the way, or the
    paper's, by trajectory matching.
    """

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
    clearance_m: Annotated[float, *PositioningSettings.model_fields["clearance_m"].metadata]


LookingAndMovingBody = body_of(
    "LookingAndMovingBody",
    "Looking and moving: closed loop at camera rate. Settings left out are as configured.",
    ServoingSettings,
    gain=0.5,
    pull_gain=None,
    clearance_m=0.1,
    settle_mm=Copy(1.0, also={"settle_growth": 0.0}),  # asked for by name, it is not to be widened
    timeout_s=None,
    target=_TARGET,
)


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
