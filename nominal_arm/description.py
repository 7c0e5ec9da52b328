"""What arm.yaml may say: the nominal arm, with bounds on every number."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from foundation.configuration import StrictModel

JOINT_NAMES = ("slew", "lift", "tilt", "wrist1", "wrist2", "wrist3")

# Table 1 of Mäkinen et al. 2023: link twists of the paper's arm, and which lengths are zero in its structure.
_JOINTS = 6
_TWISTS_DEG = (90.0, 0.0, 90.0, 90.0, -90.0, 90.0, 90.0)
_LENGTH_ALLOWED = (True, True, True, False, False, False, False)
_OFFSET_ALLOWED = (True, False, False, True, False, True, False)


class DhRow(StrictModel):
    """One link of the Denavit-Hartenberg table."""

    name: str
    alpha_deg: float = Field(ge=-180.0, le=180.0)
    a_m: float = Field(ge=-10.0, le=10.0)
    theta_offset_deg: float = Field(ge=-360.0, le=360.0)
    d_m: float = Field(ge=-10.0, le=20.0)


class JointConfig(StrictModel):
    """Range and greatest planned speed of one joint."""

    name: str
    lower_deg: float = Field(ge=-360.0, le=360.0)
    upper_deg: float = Field(ge=-360.0, le=360.0)
    speed_deg_s: float = Field(gt=0.0, le=180.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.lower_deg >= self.upper_deg:
            raise ValueError(f"lower_deg {self.lower_deg} must lie below upper_deg {self.upper_deg}")
        return self


class RotaryDrive(StrictModel):
    """A vane or rack actuator: joint speed at full spool."""

    name: str
    kind: Literal["rotary"]
    speed_rad_s: float = Field(gt=0.0, le=50.0)


class CylinderDrive(StrictModel):
    """A cylinder in a triangle linkage: x = sqrt(long² + short² + 2 long short cos(q + angle_offset))."""

    name: str
    kind: Literal["cylinder"]
    long_m: float = Field(gt=0.0, le=10.0)
    short_m: float = Field(gt=0.0, le=5.0)
    angle_offset_rad: float = Field(ge=-7.0, le=7.0)
    extend_m_s: float = Field(gt=0.0, le=5.0)
    retract_m_s: float = Field(gt=0.0, le=5.0)
    area_ratio: float = Field(gt=0.0, le=1.0)


Drive = Annotated[RotaryDrive | CylinderDrive, Field(discriminator="kind")]
Interval = tuple[Annotated[float, Field(ge=-50.0, le=50.0)], Annotated[float, Field(ge=-50.0, le=50.0)]]


class Workspace(StrictModel):
    """Box in the base frame, and the least distance from the slew axis, for the tool centre point."""

    x_m: Interval
    y_m: Interval
    z_m: Interval
    radius_min_m: float = Field(ge=0.0, le=20.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for axis, (low, high) in (("x_m", self.x_m), ("y_m", self.y_m), ("z_m", self.z_m)):
            if low >= high:
                raise ValueError(f"{axis}: lower end {low} must lie below upper end {high}")
        return self


class RatedSupply(StrictModel):
    """The pressures at which the drives' speeds hold."""

    supply_bar: float = Field(gt=0.0, le=400.0)
    return_bar: float = Field(ge=0.0, le=100.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.supply_bar < 2.0 * self.return_bar + 10.0:
            raise ValueError(f"supply_bar {self.supply_bar} leaves nothing over return_bar {self.return_bar}")
        return self


class NominalArm(StrictModel):
    """The nominal arm: seven DH rows of the paper's structure, six joints and drives, the workspace."""

    name: str
    dh: tuple[DhRow, DhRow, DhRow, DhRow, DhRow, DhRow, DhRow]
    joints: tuple[JointConfig, JointConfig, JointConfig, JointConfig, JointConfig, JointConfig]
    drives: tuple[Drive, Drive, Drive, Drive, Drive, Drive]
    rated: RatedSupply
    workspace: Workspace

    @model_validator(mode="before")
    @classmethod
    def _has_six_joints(cls, data: Any) -> Any:
        """In the owner's words, before what is missing is listed by number."""
        joints = data.get("joints") if isinstance(data, dict) else None
        if isinstance(joints, list) and len(joints) != _JOINTS:
            names = [str(one.get("name", "?")) if isinstance(one, dict) else "?" for one in joints]
            raise ValueError(
                f"{len(joints)} joints ({', '.join(names)}), wanted are 6: slew, lift, tilt, and a wrist "
                "of three whose axes meet in a point; an arm without such a wrist cannot be driven here"
            )
        return data

    @model_validator(mode="after")
    def _structure(self) -> Self:
        """Table 1's structure; the closed-form inverse kinematics holds for no other, others are refused."""
        allowed = zip(self.dh, _TWISTS_DEG, _LENGTH_ALLOWED, _OFFSET_ALLOWED, strict=True)
        for row, twist, length, offset in allowed:
            if row.alpha_deg != twist:
                raise ValueError(f"dh {row.name}: alpha_deg = {row.alpha_deg}, Table 1 has {twist}")
            if row.a_m != 0.0 and not length:
                raise ValueError(f"dh {row.name}: a_m = {row.a_m}, Table 1 has 0")
            if row.d_m != 0.0 and not offset:
                raise ValueError(f"dh {row.name}: d_m = {row.d_m}, Table 1 has 0")
        mock = self.dh[6]
        if mock.theta_offset_deg != 0.0:
            raise ValueError(f"dh {mock.name}: theta_offset_deg = {mock.theta_offset_deg}, Table 1 has 0")
        for kind, parts in (("joints", self.joints), ("drives", self.drives)):
            names = tuple(part.name for part in parts)
            if names != JOINT_NAMES:
                raise ValueError(f"{kind}: names {names} must be {JOINT_NAMES}")
        return self
