"""Settings of targets without markers."""

from typing import Annotated

from pydantic import Field, model_validator

from foundation.configuration import StrictModel

Distance = Annotated[float, Field(gt=0.05, le=100.0)]


class TargetSettings(StrictModel):
    """Where targets are looked for, and how wide drill holes are.

    A hole counts when its diameter is within ``diameter_tolerance`` of ``diameter_mm``. Of a carried target
    the odometry's error is ``carried_std_m`` and ``carried_std`` of the way.
    """

    nearest_m: Distance = 0.3
    farthest_m: Distance = 4.0
    diameter_mm: float = Field(45.0, gt=5.0, le=500.0)
    diameter_tolerance: float = Field(0.15, gt=0.0, le=0.5)
    kept_s: float = Field(3.0, gt=0.0, le=60.0)
    carried_std_m: float = Field(0.0002, ge=0.0, le=0.1)
    carried_std: float = Field(0.001, ge=0.0, le=0.1)

    @model_validator(mode="after")
    def _ordered(self) -> "TargetSettings":
        if not self.nearest_m < self.farthest_m:
            raise ValueError(f"nearest_m {self.nearest_m:g} must be below farthest_m {self.farthest_m:g}")
        return self

    @property
    def depths_m(self) -> tuple[float, float]:
        """Nearest and farthest."""
        return self.nearest_m, self.farthest_m

    def diameters_m(self, diameter_mm: float | None) -> tuple[float, float]:
        """The least and the greatest diameter of a hole of ``diameter_mm`` (None: as configured)."""
        wanted = 1e-3 * (self.diameter_mm if diameter_mm is None else diameter_mm)
        return wanted * (1.0 - self.diameter_tolerance), wanted * (1.0 + self.diameter_tolerance)
