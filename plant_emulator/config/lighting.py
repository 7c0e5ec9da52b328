"""Configuration of the light: a shadow whose edge wanders over the scene, and a lamp that glares."""

import math

from pydantic import Field, model_validator

from foundation.configuration import StrictModel


class ShadowConfig(StrictModel):
    """Shade on one side of a straight edge that wanders; light falls along z_O, the same at all depths.

    Points whose way along ``direction_deg`` (in O, from x towards y) is less than the edge's keep ``factor``
    of their light; 1: no shadow. The edge is ``start_m`` along that direction at time 0 and wanders with
    ``speed_m_s``; after ``way_m`` it begins again. ``penumbra_m`` is the width of its ramp. ``carried``: the
    lamp and what stands before it are on the arm, and ``start_m`` counts from the camera, not from O.
    """

    factor: float = Field(default=1.0, ge=0.0, le=1.0)
    direction_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    start_m: float = Field(default=-1.0, ge=-20.0, le=20.0)
    speed_m_s: float = Field(default=0.1, ge=0.0, le=20.0)
    way_m: float = Field(default=2.0, gt=0.0, le=100.0)
    penumbra_m: float = Field(default=0.02, ge=0.001, le=2.0)
    carried: bool = False

    @property
    def normal(self) -> tuple[float, float]:
        """The direction's x and y in O."""
        angle = math.radians(self.direction_deg)
        return math.cos(angle), math.sin(angle)

    def edge_m(self, time_s: float, camera_m: tuple[float, float]) -> float:
        """Where the edge is along its direction; ``camera_m``: x and y of the camera in O."""
        edge_m = self.start_m + self.speed_m_s * time_s % self.way_m
        if not self.carried:
            return edge_m
        return edge_m + self.normal[0] * camera_m[0] + self.normal[1] * camera_m[1]


class GlareConfig(StrictModel):
    """The highlight of a lamp at ``lamp_m`` (in O) on glossy plates, which are the markers': it moves as one
    looks from elsewhere.

    ``strength_grey`` is added where the lamp's mirror image lies, less around it as a bell of standard
    deviation ``width_m`` on the plate; 0: matt plates.
    """

    strength_grey: float = Field(default=0.0, ge=0.0, le=2000.0)
    width_m: float = Field(default=0.02, gt=0.0, le=1.0)
    lamp_m: tuple[float, float, float] = (-0.3, 0.6, 2.0)

    @model_validator(mode="after")
    def _lamp_before_the_wall(self) -> "GlareConfig":
        if not self.lamp_m[2] > 0.0:
            raise ValueError(
                f"lamp_m {self.lamp_m}: z must be above 0, a lamp behind the wall lights nothing"
            )
        return self


class LightingConfig(StrictModel):
    """What light does beside the wall's gradient."""

    shadow: ShadowConfig = ShadowConfig()
    glare: GlareConfig = GlareConfig()
