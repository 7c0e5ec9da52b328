"""What a request may say of a program, and the settings that it is laid over.

A member that is left out is as configured. Lengths of a few millimetres are asked for in mm: such a member
gives the settings' field in m.
"""

import math
from dataclasses import astuple
from typing import Annotated, Any, Literal

from pydantic import Field, create_model, model_validator

from foundation.configuration import StrictModel
from vision_pc.config.choices import PositioningMethod
from vision_pc.config.programs import OrientationSettings, PositioningSettings, VisualServoingSettings

Metres = Annotated[float, Field(ge=-10.0, le=10.0)]
Vector = tuple[Metres, Metres, Metres]
Unit = Annotated[float, Field(ge=-1.001, le=1.001)]
Target = Annotated[
    str,
    Field(
        max_length=20,
        description="Of `/targets`, or `markers`: it is aimed at from then on. Left out: what is aimed at,"
        " which another client may have changed just now",
    ),
]


class RequestBody(StrictModel):
    """What a request may say, as strict as the configuration; what is left out is as configured."""

    def overrides(self) -> dict[str, Any]:
        """The members that were given, as fields of the settings."""
        given = self.model_dump(exclude_none=True)
        return {_in_metres(key): 1e-3 * v if key.endswith("_mm") else v for key, v in given.items()}


def body_of(
    settings: type[StrictModel], *members: str, base: type[RequestBody] = RequestBody
) -> type[RequestBody]:
    """The body of ``members`` of ``settings``, each within its limits there, or None: as configured.

    A member in ``_mm`` is the settings' field in ``_m``. ``base``: what else the body has.
    """
    fields: dict[str, Any] = {}
    for name in members:
        field = settings.model_fields[_in_metres(name)]
        limits, examples = field.metadata, field.examples
        if name.endswith("_mm"):
            limits = [type(limit)(1e3 * bound) for limit in limits for bound in astuple(limit)]
            examples = [1e3 * example for example in examples or ()] or None
        kind: Any = Annotated[field.annotation, name, *limits]
        fields[name] = (kind | None, Field(None, description=field.description, examples=examples))
    name, doc = settings.__name__.replace("Settings", "Body"), (settings.__doc__ or "").partition("\n\n")[0]
    return create_model(name, __base__=base, __doc__=doc, **fields)


def _in_metres(member: str) -> str:
    return f"{member.removesuffix('mm')}m" if member.endswith("_mm") else member


class LookBody(RequestBody):
    """A look: ``frames`` pairs with the arm at rest."""

    frames: int | None = Field(None, ge=1, le=100, examples=[10])


class TurnSettings(OrientationSettings):
    """Orientation adjustment, and parallel to which target (None: as aimed)."""

    target: Target | None = Field(None, examples=[None])


class LookThenMoveSettings(PositioningSettings):
    """Look-then-move, by which calibration, and to which target (None: as aimed)."""

    method: PositioningMethod = PositioningMethod.CORRECTED
    target: Target | None = Field(None, examples=[None])


class MethodBody(RequestBody):
    """Look-then-move by either method."""

    method: Literal["corrected", "paper"] = Field(
        "corrected",
        description="By the local track, corrected by odometry on the way, or the paper's, by trajectory "
        "matching",
    )

    @model_validator(mode="after")
    def _of_the_method(self) -> "MethodBody":
        other = {"corrected": ("inputs", "paper"), "paper": ("corrections", "corrected")}
        member, method = other[self.method]
        if getattr(self, member) is not None:
            raise ValueError(f"{member} = {getattr(self, member)} is of method {method}, not {self.method}")
        return self


class ServoingSettings(VisualServoingSettings):
    """Visual servoing, the distance to the object that it shall leave, and which target (None: as aimed)."""

    target: Target | None = Field(None, examples=[None])
    clearance_m: float = Field(ge=0.0, le=1.0, examples=[0.1])


class SettlingBody(RequestBody):
    """Looking and moving: closed loop at camera rate."""

    def overrides(self) -> dict[str, Any]:
        """As given; a settling limit that was asked for is not widened."""
        given = super().overrides()
        return given | ({"wanted_m": 0.0} if "settle_m" in given else {})


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


class MoveBody(HomeBody):
    """A point-to-point motion: to ``X_BT``, or by an offset along the axes of base or tool (just one)."""

    X_BT: PoseBody | None = None
    offset_base_m: Vector | None = None
    offset_tool_m: Vector | None = Field(None, examples=[[0.05, 0.0, 0.0]])

    @model_validator(mode="after")
    def _one_target(self) -> "MoveBody":
        if sum(t is not None for t in (self.X_BT, self.offset_base_m, self.offset_tool_m)) != 1:
            raise ValueError("exactly one of X_BT, offset_base_m and offset_tool_m is wanted")
        return self
