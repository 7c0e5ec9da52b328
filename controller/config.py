"""What controller.yaml may say, with bounds on every number."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from foundation.configuration import Host, StrictModel, or_its_file
from foundation.secret_source import SecretSource
from nominal_arm.commissioned import Commissioned, ValveSet

# How late a scan may be without breaking streaming.silence_ms.
_STREAM_MARGIN_MS = 2.0
PARKING_BAND_MOST_MRAD = 0.2  # [D] two thirds of settled.tolerance_mrad

Gain = Annotated[float, Field(gt=0.0, le=50.0)]
Damping = Annotated[float, Field(ge=0.0, le=100.0)]
FollowingError = Annotated[float, Field(gt=0.0, le=90.0)]


class PoseServoConfig(StrictModel):
    """Gains of the Cartesian law (4), dead zone of its integral (5)."""

    position_gain_1_s: float = Field(ge=0.0, le=20.0)
    orientation_gain_1_s: float = Field(ge=0.0, le=40.0)
    dead_zone_mrad: float = Field(ge=0.0, le=5.0)


class JointControlConfig(StrictModel):
    """Joint control (6), PT-1 (25) on lift and tilt; feed-forward, pressure damping."""

    gain_1_s: tuple[Gain, Gain, Gain, Gain, Gain, Gain]
    pt1_time_constant_ms: float = Field(ge=0.0, le=2000.0)
    feed_forward: float = Field(ge=0.0, le=1.5)
    load_compensation: bool
    pressure_damping_mrad_s_bar: tuple[Damping, Damping, Damping, Damping, Damping, Damping]
    pressure_high_pass_ms: float = Field(gt=0.0, le=10_000.0)
    deadband_blend: float = Field(gt=0.0, le=0.2)
    valve_limit: float = Field(gt=0.0, le=1.0)


class LoadHoldingConfig(StrictModel):
    """How joints are lowered whose load a load-holding valve keeps; without it they are lowered as others."""

    pilot_damping_mrad_s_bar: tuple[Damping, Damping, Damping, Damping, Damping, Damping] = (0.0,) * 6
    pilot_high_pass_ms: float = Field(default=1500.0, gt=0.0, le=60_000.0)
    setting_bar: float = Field(default=250.0, gt=0.0, le=1000.0)
    pilot_ratio: float = Field(default=4.0, gt=0.0, le=50.0)


OilSpring = Annotated[float, Field(ge=0.0, le=10.0)]


class ParkingConfig(StrictModel):
    """How the arm is brought to rest at the end of a motion and kept there.

    ``enabled``: ``auto`` parks behind valves with hysteresis alone; false, or else, the joint law goes on.
    """

    enabled: bool | Literal["auto"]
    band_mm: float = Field(gt=0.0, le=20.0)
    loaded: tuple[bool, bool, bool, bool, bool, bool]
    stays_ms: float = Field(gt=0.0, le=600_000.0)
    oil_mrad_bar: tuple[OilSpring, OilSpring, OilSpring, OilSpring, OilSpring, OilSpring]


class MotionConfig(StrictModel):
    """Limits of planned motion, and what is refused at the door."""

    speed_m_s: float = Field(gt=0.0, le=3.0)
    acceleration_m_s2: float = Field(gt=0.0, le=10.0)
    turn_speed_deg_s: float = Field(gt=0.0, le=180.0)
    turn_acceleration_deg_s2: float = Field(gt=0.0, le=720.0)
    duration_min_s: float = Field(ge=0.05, le=10.0)
    duration_max_s: float = Field(gt=0.0, le=3600.0)
    stop_acceleration_m_s2: float = Field(gt=0.0, le=20.0)
    stop_turn_acceleration_deg_s2: float = Field(gt=0.0, le=1440.0)
    stop_min_s: float = Field(ge=0.02, le=5.0)
    first_point_distance_m: float = Field(gt=0.0, le=50.0)
    singular_value_min: float = Field(ge=0.0, le=0.5)


class StreamingConfig(StrictModel):
    """How streamed references are followed, what is refused of them, and when the arm stops without them."""

    speed_m_s: float = Field(gt=0.0, le=3.0)
    acceleration_m_s2: float = Field(gt=0.0, le=10.0)
    jerk_m_s3: float = Field(gt=0.0, le=200.0)
    turn_speed_deg_s: float = Field(gt=0.0, le=180.0)
    turn_acceleration_deg_s2: float = Field(gt=0.0, le=720.0)
    turn_jerk_deg_s3: float = Field(gt=0.0, le=20_000.0)
    distance_m: float = Field(gt=0.0, le=5.0)
    turn_deg: float = Field(gt=0.0, le=90.0)
    max_age_ms: float = Field(gt=0.0, le=5000.0)
    first_reference_ms: float = Field(ge=50.0, le=10_000.0)
    silence_ms: float = Field(ge=20.0, le=1000.0)
    ramp_ms: float = Field(ge=2.0, le=500.0)
    recovery_ms: float = Field(ge=2.0, le=2000.0)


class SettledConfig(StrictModel):
    """When the arm counts as settled: joint-equivalent error inside the tolerance for the whole time."""

    tolerance_mrad: float = Field(gt=0.0, le=20.0)
    time_ms: float = Field(ge=0.0, le=10_000.0)


class SupervisionConfig(StrictModel):
    """When the controller stops by itself."""

    missed_exchanges: int = Field(ge=1, le=1000)
    silence_ms: float = Field(gt=0.0, le=5000.0)
    frozen_exchanges: int = Field(ge=1, le=1000)
    echo_lag_cycles: int = Field(ge=1, le=1000)
    overrun_ms: float = Field(gt=0.0, le=5000.0)
    following_error_deg: tuple[
        FollowingError, FollowingError, FollowingError, FollowingError, FollowingError, FollowingError
    ]
    encoder_jump_deg: float = Field(gt=0.0, le=90.0)
    encoder_stuck_opening: float = Field(gt=0.0, le=1.0)
    encoder_stuck_ms: float = Field(gt=0.0, le=10_000.0)
    overspeed_m_s: float = Field(gt=0.0, le=10.0)
    overspeed_ms: float = Field(ge=0.0, le=1000.0)
    supply_min_bar: float = Field(ge=0.0, le=400.0)
    workspace_margin_m: float = Field(ge=0.0, le=2.0)
    joint_overtravel_deg: float = Field(ge=0.0, le=10.0)


class ExcitationConfig(StrictModel):
    """What the valves are tried out with in the start-up mode ``enabled``, joint by joint in this order."""

    enabled: bool
    joints: tuple[Annotated[int, Field(ge=0, le=5)], ...] = Field(min_length=1, max_length=6)
    ramps: int = Field(ge=2, le=10)
    spool_max: float = Field(gt=0.0, le=0.5)
    pressure_bar: float = Field(gt=0.0, le=655.0)

    @model_validator(mode="after")
    def _named_once(self) -> Self:
        if len(set(self.joints)) != len(self.joints):
            raise ValueError(f"joints: {self.joints} names a joint twice")
        return self


class PlantLinkConfig(StrictModel):
    """Where the plant's Modbus TCP face is, and how long one exchange may take."""

    host: Host
    port: int = Field(ge=1, le=65535)
    unit_id: int = Field(ge=0, le=247)
    timeout_ms: float = Field(ge=1.0, le=1000.0)
    reconnect_ms: float = Field(ge=10.0, le=60_000.0)


class ReferenceLinkConfig(StrictModel):
    """Where the UDP reference server listens (port 0: any free one) and when its peer counts as gone.

    ``link_key``: where the shared key is; with a key, only authenticated sessions are granted.
    """

    host: Host
    port: int = Field(ge=0, le=65535)
    link_timeout_ms: int = Field(ge=20, le=60_000)
    link_key: SecretSource = SecretSource()


class AdsConfig(StrictModel):
    """Where the controller in structured text shows its variables over ADS; ``port`` 0: nowhere.

    ``writable``: whoever connects may also change numbers. ADS has no authentication.
    """

    host: Host = "127.0.0.1"
    port: int = Field(default=0, ge=0, le=65535)
    writable: bool = False


class ControllerConfig(StrictModel):
    """controller.yaml as a whole.

    ``valves``: what is known of them before commissioning. ``commissioned``: what commissioning found, its
    file's path or its content, null before; see ``commissioning.commissioned_config``.
    """

    cycle_ms: float = Field(ge=1.0, le=10.0)
    valves: Annotated[ValveSet, or_its_file(ValveSet)]
    commissioned: Annotated[Commissioned, or_its_file(Commissioned)] | None
    scan_lead: float = Field(ge=0.1, le=1.0)
    pose_servo: PoseServoConfig
    joint_control: JointControlConfig
    load_holding: LoadHoldingConfig = LoadHoldingConfig()
    parking: ParkingConfig
    motion: MotionConfig
    streaming: StreamingConfig
    settled: SettledConfig
    supervision: SupervisionConfig
    excitation: ExcitationConfig
    plant_link: PlantLinkConfig
    reference_link: ReferenceLinkConfig
    ads: AdsConfig = AdsConfig()
    flight_recorder_scans: int = Field(ge=1, le=100_000)
    recording_hz: float = Field(default=0.0, ge=0.0, le=1000.0)
    fifo_priority: int = Field(ge=0, le=99)

    @model_validator(mode="after")
    def _settles(self) -> Self:
        if self.pose_servo.dead_zone_mrad >= self.settled.tolerance_mrad:
            raise ValueError(
                f"pose_servo.dead_zone_mrad = {self.pose_servo.dead_zone_mrad} must lie below "
                f"settled.tolerance_mrad = {self.settled.tolerance_mrad}, or the arm never settles"
            )
        return self

    @property
    def parks(self) -> bool:
        """Whether the arm parks; ``auto``: behind valves of which any may have hysteresis."""
        setting = self.parking.enabled
        return setting is True or (setting == "auto" and not all(valve.exact for valve in self.valves.joints))

    @property
    def stream_close_ms(self) -> float:
        """Silence in a stream at which a scan centres the valves, so that the plant has it by silence_ms.

        A scan's valve image reaches the plant with the next exchange and is in force until the one after it.
        """
        return self.streaming.silence_ms - 2.0 * self.cycle_ms - _STREAM_MARGIN_MS

    @model_validator(mode="after")
    def _parks_inside(self) -> Self:
        if self.parks and self.settled.tolerance_mrad <= PARKING_BAND_MOST_MRAD:
            raise ValueError(
                f"settled.tolerance_mrad = {self.settled.tolerance_mrad} must lie above "
                f"{PARKING_BAND_MOST_MRAD}, a parked joint's band, or a parked arm never settles"
            )
        return self

    @model_validator(mode="after")
    def _closes_in_time(self) -> Self:
        if self.stream_close_ms - self.streaming.ramp_ms < 2.0 * self.cycle_ms:
            raise ValueError(
                f"streaming.silence_ms = {self.streaming.silence_ms} leaves no time to wait for a reference "
                f"before a ramp of {self.streaming.ramp_ms} ms and the way to the plant"
            )
        return self
