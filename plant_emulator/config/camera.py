"""Configuration of the stereo camera as it truly is; vision is told other, nominal numbers."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from foundation.configuration import StrictModel


class ShadowConfig(StrictModel):
    """Shade on one side of a straight edge that wanders; light falls along z_O, the same at all depths.

    Points whose way along ``direction_deg`` (in O, from x towards y) is less than the edge's keep ``factor``
    of their light; 1: no shadow. The edge is ``start_m`` along that direction at time 0 and wanders with
    ``speed_m_s``; after ``way_m`` it begins again. ``penumbra_m`` is the width of its ramp.
    """

    factor: float = Field(default=1.0, ge=0.0, le=1.0)
    direction_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    start_m: float = Field(default=-1.0, ge=-20.0, le=20.0)
    speed_m_s: float = Field(default=0.1, ge=0.0, le=20.0)
    way_m: float = Field(default=2.0, gt=0.0, le=100.0)
    penumbra_m: float = Field(default=0.02, ge=0.001, le=2.0)

    @property
    def normal(self) -> tuple[float, float]:
        """The direction's x and y in O."""
        angle = math.radians(self.direction_deg)
        return math.cos(angle), math.sin(angle)

    def edge_m(self, time_s: float) -> float:
        """Where the edge is along its direction."""
        return self.start_m + self.speed_m_s * time_s % self.way_m


class GlareConfig(StrictModel):
    """The highlight of a lamp at ``lamp_m`` (in O) on glossy plates, which are the markers': it moves as one
    looks from elsewhere. A lamp behind the wall (z ≤ 0) would light nothing.

    ``strength_grey`` is added where the lamp's mirror image lies, less around it as a bell of standard
    deviation ``width_m`` on the plate; 0: matt plates.
    """

    strength_grey: float = Field(default=0.0, ge=0.0, le=2000.0)
    width_m: float = Field(default=0.02, gt=0.0, le=1.0)
    lamp_m: tuple[float, float, Annotated[float, Field(gt=0.0)]] = (-0.3, 0.6, 2.0)


class LightingConfig(StrictModel):
    """What light does beside the wall's gradient."""

    shadow: ShadowConfig = ShadowConfig()
    glare: GlareConfig = GlareConfig()


class LensConfig(StrictModel):
    """True pinhole and Brown-Conrady coefficients (OpenCV's signs) of the left eye's pictures."""

    fx_px: float = Field(ge=100.0, le=5000.0)
    fy_px: float = Field(ge=100.0, le=5000.0)
    cx_px: float = Field(ge=0.0, le=4000.0)
    cy_px: float = Field(ge=0.0, le=4000.0)
    k1: float = Field(default=0.0, ge=-0.5, le=0.5)
    k2: float = Field(default=0.0, ge=-0.5, le=0.5)
    p1: float = Field(default=0.0, ge=-0.05, le=0.05)
    p2: float = Field(default=0.0, ge=-0.05, le=0.05)
    k3: float = Field(default=0.0, ge=-0.5, le=0.5)


class RectificationConfig(StrictModel):
    """What the vendor's rectification leaves: a shift of the right picture, and a rotation of the right eye.

    ``disparity_px`` is added to every disparity u_left - u_right, ``vertical_px`` to v_right - v_left.
    """

    vertical_px: float = Field(default=0.0, ge=-10.0, le=10.0)
    disparity_px: float = Field(default=0.0, ge=-10.0, le=10.0)
    right_eye_rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


class LensDifferenceConfig(StrictModel):
    """What the right eye's lens has more than the left's: no two lenses are alike. Zero: the same lens."""

    fx_px: float = Field(default=0.0, ge=-50.0, le=50.0)
    fy_px: float = Field(default=0.0, ge=-50.0, le=50.0)
    cx_px: float = Field(default=0.0, ge=-50.0, le=50.0)
    cy_px: float = Field(default=0.0, ge=-50.0, le=50.0)
    k1: float = Field(default=0.0, ge=-0.1, le=0.1)
    k2: float = Field(default=0.0, ge=-0.1, le=0.1)
    p1: float = Field(default=0.0, ge=-0.01, le=0.01)
    p2: float = Field(default=0.0, ge=-0.01, le=0.01)
    k3: float = Field(default=0.0, ge=-0.1, le=0.1)

    def added_to(self, lens: LensConfig) -> LensConfig:
        """The right eye's lens, the left one being ``lens``. Raises ValidationError out of its ranges."""
        more = self.model_dump()
        return LensConfig(**{name: value + more[name] for name, value in lens.model_dump().items()})


class DriftConfig(StrictModel):
    """How the rectification wanders as the camera warms and cools: the right eye turns a little.

    Two independent first-order walks begin at zero with the first exposure. ``disparity_px`` and
    ``vertical_px`` are the standard deviations that they settle at, at the principal point; after a time t
    they are that times sqrt(1 - exp(-2 t / ``time_constant_s``)). Zero: no drift.
    """

    disparity_px: float = Field(default=0.0, ge=0.0, le=5.0)
    vertical_px: float = Field(default=0.0, ge=0.0, le=5.0)
    time_constant_s: float = Field(default=600.0, ge=1.0, le=86_400.0)


_LINE_US = {60: 15.7, 30: 25.6, 15: 51.2}  # [S] Stereolabs support: 11.3, 18.4 and 36.9 ms for the 720 rows


class ShutterConfig(StrictModel):
    """When the rows are exposed: all at once (``global``), or one after the other (``rolling``).

    A rolling shutter reads row by row; ``mode_hz`` is the rate at which the sensor runs, whatever share of
    its frames ``rate_hz`` lets pass. Stamps are of the middle row.
    """

    kind: Literal["global", "rolling"] = "global"
    mode_hz: Literal[60, 30, 15] = 30

    @property
    def line_s(self) -> float:
        """Time from a row to the next (s), 0 for a global shutter."""
        return 1e-6 * _LINE_US[self.mode_hz] if self.kind == "rolling" else 0.0


class StampsConfig(StrictModel):
    """What is wrong with the capture times that are told: told minus true.

    ``delay_ms`` is constant and ``jitter_ms`` the standard deviation of a normal error of each frame, cut off
    at three times that.
    """

    delay_ms: float = Field(default=0.0, ge=-200.0, le=200.0)
    jitter_ms: float = Field(default=0.0, ge=0.0, le=50.0)


class AutoExposureConfig(StrictModel):
    """The servo of both eyes' gain: it brings the left picture's mean, before the response curve, to
    ``mean_grey``.

    The gain follows what it should be with ``time_constant_s``.
    """

    enabled: bool = False
    mean_grey: float = Field(default=110.0, ge=5.0, le=250.0)
    time_constant_s: float = Field(default=0.3, ge=0.01, le=60.0)


class DirtConfig(StrictModel):
    """A smear on one eye's lens, far out of focus: it stays at its place in the picture.

    It lets ``transmission`` of the light pass in its middle and adds ``scatter_grey``; both fade outwards as
    a bell of standard deviation ``radius_px``.
    """

    eye: Literal["left", "right"]
    centre_px: tuple[float, float]
    radius_px: float = Field(default=80.0, ge=5.0, le=2000.0)
    transmission: float = Field(default=0.6, ge=0.0, le=1.0)
    scatter_grey: float = Field(default=0.0, ge=0.0, le=255.0)


class CameraConfig(StrictModel):
    """The stereo camera as it really is. Vision is told other, nominal numbers.

    ``lens`` is the left eye's. ``response_gamma``: white times (light / white) to that power is the grey;
    ``exposure_gain`` is how bright the scene is before ``auto_exposure`` meters it.
    """

    width_px: int = Field(default=1280, ge=64, le=4096)
    height_px: int = Field(default=720, ge=64, le=4096)
    rate_hz: float = Field(gt=0.0, le=120.0)
    exposure_us: int = Field(ge=0, le=100_000)
    baseline_m: float = Field(gt=0.0, le=1.0)
    lens: LensConfig
    lens_difference: LensDifferenceConfig = LensDifferenceConfig()
    rectification: RectificationConfig = RectificationConfig()
    drift: DriftConfig = DriftConfig()
    blur_px: float = Field(default=0.0, ge=0.0, le=5.0)
    noise_grey: float = Field(default=0.0, ge=0.0, le=50.0)
    exposure_gain: float = Field(default=1.0, ge=0.0, le=16.0)
    auto_exposure: AutoExposureConfig = AutoExposureConfig()
    response_gamma: float = Field(default=1.0, ge=0.2, le=3.0)
    dirt: tuple[DirtConfig, ...] = Field(default=(), max_length=16)
    vignetting: float = Field(default=0.0, ge=0.0, le=0.9)
    shutter: ShutterConfig = ShutterConfig()
    stamps: StampsConfig = StampsConfig()

    @property
    def shows_motion(self) -> bool:
        """Whether its pictures depend on how it moves."""
        return self.shutter.kind == "rolling"

    @model_validator(mode="after")
    def _stamps_keep_their_order(self) -> "CameraConfig":
        spread_ms = 6.0 * self.stamps.jitter_ms
        if not spread_ms * self.rate_hz < 1000.0:
            raise ValueError(
                f"stamps.jitter_ms {self.stamps.jitter_ms:g}: stamps {spread_ms:g} ms apart at worst would "
                f"change places at {self.rate_hz:g} frames a second"
            )
        return self

    @model_validator(mode="after")
    def _rows_fit_into_a_frame(self) -> "CameraConfig":
        readout_s = self.shutter.line_s * self.height_px
        if readout_s * self.rate_hz > 1.0:
            raise ValueError(
                f"shutter.mode_hz {self.shutter.mode_hz}: {self.height_px} rows take "
                f"{1e3 * readout_s:.1f} ms, longer than a frame at rate_hz {self.rate_hz:g}"
            )
        return self

    @model_validator(mode="after")
    def _lenses_see_the_picture(self) -> "CameraConfig":
        _refuse_bad_lens("lens", self.lens, self.width_px, self.height_px)
        right = self.lens_difference.added_to(self.lens)
        _refuse_bad_lens("lens + lens_difference", right, self.width_px, self.height_px)
        return self


def _refuse_bad_lens(name: str, lens: LensConfig, width_px: int, height_px: int) -> None:
    """Raise ValueError when the picture folds over, or its principal point lies outside."""
    if not (lens.cx_px < width_px and lens.cy_px < height_px):
        raise ValueError(f"{name}: cx_px, cy_px: the principal point must lie inside the picture")
    corner = math.hypot(
        max(lens.cx_px, width_px - lens.cx_px) / lens.fx_px,
        max(lens.cy_px, height_px - lens.cy_px) / lens.fy_px,
    )
    step, radius = 0.01, 0.0
    while True:
        r2 = radius * radius
        if 1.0 + r2 * (3.0 * lens.k1 + r2 * (5.0 * lens.k2 + r2 * 7.0 * lens.k3)) <= 0.0:
            raise ValueError(
                f"{name}: k1, k2, k3: the picture folds over at {radius:.2f}, the corner is at {corner:.2f}"
            )
        if radius * (1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))) > corner:
            return
        radius += step
