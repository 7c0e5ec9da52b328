"""Configuration of the valves: what all six share, what differs from joint to joint, and what holds loads."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, ValidationInfo, field_validator, model_validator

from foundation.configuration import StrictModel
from plant_emulator.config.structure import Positive

JointName = Literal["slew", "lift", "tilt", "wrist1", "wrist2", "wrist3"]

JOINT_NAMES: tuple[JointName, ...] = ("slew", "lift", "tilt", "wrist1", "wrist2", "wrist3")
LEAST_TRAVEL = 0.5  # of the spool's way must be left to meter with

Overlap = Annotated[float, Field(ge=0.0, le=0.5)]
Slope = Annotated[float, Field(ge=0.05, le=2.0)]
Speed = Annotated[float, Field(gt=0.0, le=1e7)]
Flow = Annotated[float, Field(gt=0.0, le=1000.0)]
ActuatorLeakage = Annotated[float, Field(ge=0.0, le=1e-10)]


class EachPart(StrictModel):
    """Numbers that one number may stand for."""

    @classmethod
    def spread(cls, data: Any) -> Any:
        """A plain number as each of the parts."""
        return dict.fromkeys(cls.model_fields, data) if isinstance(data, int | float) else data

    @model_validator(mode="before")
    @classmethod
    def _one_for_all(cls, data: Any) -> Any:
        return cls.spread(data)


class EdgeOverlaps(EachPart):
    """How far the spool travels, of its full stroke, before each of its four metering edges opens.

    One number stands for all four. Extending opens ``supply_a`` and ``return_b``, retracting ``supply_b``
    and ``return_a``. Negative overlap (an open centre) is not modelled.
    """

    supply_a: Overlap | None = None
    return_b: Overlap | None = None
    supply_b: Overlap | None = None
    return_a: Overlap | None = None


class SlewLimits(EachPart):
    """How fast (1/s, of full stroke) the spool moves out of the centre, and back; one number for both."""

    out: Speed | None = None
    back: Speed | None = None


class DirectionSlopes(EachPart):
    """The flow curve's slope where an edge opens, over its mean slope; 1 is linear, less is progressive."""

    extend: Slope | None = None
    retract: Slope | None = None


class DirectionFlows(EachPart):
    """Rated flow at full spool (l/min) in each direction; where none is told, the actuator's."""

    extend: Flow | None = None
    retract: Flow | None = None


class JointValveConfig(StrictModel):
    """What is told of one valve; what is not told is as for all (``ValvesConfig``)."""

    bandwidth_hz: Annotated[float, Field(gt=0.0, le=300.0)] | None = None
    damping_ratio: Annotated[float, Field(gt=0.0, le=3.0)] | None = None
    slew_limit_per_s: SlewLimits = SlewLimits()
    delay_ms: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    deadband: EdgeOverlaps = EdgeOverlaps()
    hysteresis: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    initial_slope: DirectionSlopes = DirectionSlopes()
    flow_l_min: DirectionFlows = DirectionFlows()
    spool_leakage_m3_s_pa: Annotated[float, Field(ge=0.0, le=1e-11)] | None = None
    actuator_leakage_m3_s_pa: ActuatorLeakage | None = None


class CounterbalanceConfig(StrictModel):
    """Load-holding valves at chamber a: they open with p_a + pilot_ratio p_b above the setting.

    ``lag_ms``: of the opening behind the pressures, by an orifice in the pilot line; 0 without one.
    """

    lift: bool
    tilt: bool
    setting_bar: Positive
    pilot_ratio: Annotated[float, Field(ge=1.0, le=20.0)]
    range_bar: Positive
    lag_ms: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0


Joints = dict[JointName, JointValveConfig | None]


def _value_of(
    own: JointValveConfig,
    common: Mapping[str, Any],
    key: str,
    part: str | None = None,
    otherwise: float = math.nan,
) -> float:
    """What a joint's ``own`` entry says of ``key`` (of its ``part``), else what is ``common`` to all six."""
    for value in (getattr(own, key), common[key]):
        number = value if part is None else getattr(value, part)
        if number is not None:
            return float(number)
    return otherwise


def without_overridden(valve_set: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """``valve_set`` whose joints say nothing of what ``own`` says of all six; both as read from a file.

    So ``plant.valves.deadband=0.01`` holds for every valve, however much the set's own differ.
    """
    joints = valve_set.get("joints")
    if not isinstance(joints, Mapping):
        return dict(valve_set)
    stated = {key: value for key, value in own.items() if key != "joints"}
    return {**valve_set, "joints": {name: _without_common(entry, stated) for name, entry in joints.items()}}


def _without_common(entry: Any, stated: Mapping[str, Any]) -> Any:
    """A joint's ``entry`` without the keys that are ``stated``; of those stated in part, without these."""
    if not isinstance(entry, Mapping):
        return entry
    left = {}
    for key, value in entry.items():
        common, known = stated.get(key), JointValveConfig.model_fields.get(key)
        if isinstance(common, Mapping) and known is not None and isinstance(known.default, EachPart):
            whole = type(known.default).spread(value)
            if isinstance(whole, Mapping):
                left[key] = {part: number for part, number in whole.items() if common.get(part) is None}
                continue
        if common is None:
            left[key] = value
    return left


class Valve(NamedTuple):
    """One joint's valve, complete. Edges in the order supply_a, return_b, supply_b, return_a."""

    bandwidth_hz: float
    damping_ratio: float
    slew_out_per_s: float
    slew_back_per_s: float
    delay_ms: float
    deadband: tuple[float, float, float, float]
    hysteresis: float
    slope_extend: float
    slope_retract: float
    flow_extend_l_min: float
    flow_retract_l_min: float
    spool_leakage_m3_s_pa: float
    actuator_leakage_m3_s_pa: float

    def edge_flows_l_min(self) -> tuple[float, float, float, float]:
        """Rated flow (l/min) of each metering edge, fully open."""
        out, back = self.flow_extend_l_min, self.flow_retract_l_min
        return out, out, back, back


class ValvesConfig(StrictModel):
    """A set of six valves: what holds for all, and under ``joints`` what differs.

    ``compensator_bar``: what the pressure compensators before the metering edges keep across them, so that
    flow does not depend on the load; 0 without them. Rated flows hold at ``rated_drop_bar`` across an edge,
    or at the compensators' pressure. ``hysteresis``: width of the loop, command to spool, of full stroke.
    ``actuator_leakage_m3_s_pa``: across the pistons of actuators that can hold a load behind such valves, in
    place of the actuators' own numbers.
    """

    rated_drop_bar: Positive
    compensator_bar: Annotated[float, Field(ge=0.0, le=50.0)] = 0.0
    bandwidth_hz: Annotated[float, Field(gt=0.0, le=300.0)]
    damping_ratio: Annotated[float, Field(gt=0.0, le=3.0)]
    slew_limit_per_s: SlewLimits
    delay_ms: Annotated[float, Field(ge=0.0, le=100.0)]
    deadband: EdgeOverlaps
    hysteresis: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    initial_slope: DirectionSlopes = DirectionSlopes(extend=1.0, retract=1.0)
    flow_l_min: DirectionFlows = DirectionFlows()
    spool_leakage_m3_s_pa: Annotated[float, Field(ge=0.0, le=1e-11)] = 0.0
    actuator_leakage_m3_s_pa: ActuatorLeakage | None = None
    regularisation_bar: Annotated[float, Field(ge=0.1, le=20.0)]
    counterbalance: CounterbalanceConfig
    joints: Joints = Field(default_factory=dict, validate_default=True)

    @field_validator("slew_limit_per_s", "deadband", "initial_slope")
    @classmethod
    def _is_complete(cls, value: StrictModel) -> StrictModel:
        missing = [name for name, part in value if part is None]
        if missing:
            raise ValueError(f"a number is wanted for {', '.join(missing)} too, or one number for all")
        return value

    @field_validator("joints")
    @classmethod
    def _leaves_travel(cls, value: Joints, info: ValidationInfo) -> Joints:
        if not {"deadband", "hysteresis"} <= info.data.keys():
            return value
        for name in JOINT_NAMES:
            own = value.get(name) or JointValveConfig()
            loop = _value_of(own, info.data, "hysteresis")
            overlap = max(_value_of(own, info.data, "deadband", edge) for edge in EdgeOverlaps.model_fields)
            if overlap + 0.5 * loop > 1.0 - LEAST_TRAVEL:
                raise ValueError(
                    f"{name}: an overlap of {overlap:g} and half a hysteresis of {loop:g} must not take more "
                    f"than {1.0 - LEAST_TRAVEL:g} of the spool's travel: little would be left to meter with"
                )
        return value

    def edge_drops_bar(self) -> tuple[float, float, float, float]:
        """The pressure drop (bar) that each edge's rated flow stands for under the law K √Δp.

        Behind a compensator the regularised law, which stays a little below the root, meets the rated flow.
        """
        rated, compensated, soft = self.rated_drop_bar, self.compensator_bar, self.regularisation_bar
        metered = (
            compensated * compensated / math.sqrt(compensated * compensated + soft * soft)
            if compensated > 0.0
            else rated
        )
        return metered, rated, metered, rated

    def of(self, name: JointName, rated_flow_l_min: float) -> Valve:
        """The valve of joint ``name``, whose actuator is rated at ``rated_flow_l_min``.

        Its ``actuator_leakage_m3_s_pa`` is not a number where the actuator's own holds.
        """
        own = self.joints.get(name) or JointValveConfig()

        def stated(key: str, part: str | None = None, otherwise: float = math.nan) -> float:
            return _value_of(own, dict(self), key, part, otherwise)

        return Valve(
            bandwidth_hz=stated("bandwidth_hz"),
            damping_ratio=stated("damping_ratio"),
            slew_out_per_s=stated("slew_limit_per_s", "out"),
            slew_back_per_s=stated("slew_limit_per_s", "back"),
            delay_ms=stated("delay_ms"),
            deadband=(
                stated("deadband", "supply_a"),
                stated("deadband", "return_b"),
                stated("deadband", "supply_b"),
                stated("deadband", "return_a"),
            ),
            hysteresis=stated("hysteresis"),
            slope_extend=stated("initial_slope", "extend"),
            slope_retract=stated("initial_slope", "retract"),
            flow_extend_l_min=stated("flow_l_min", "extend", rated_flow_l_min),
            flow_retract_l_min=stated("flow_l_min", "retract", rated_flow_l_min),
            spool_leakage_m3_s_pa=stated("spool_leakage_m3_s_pa"),
            actuator_leakage_m3_s_pa=stated("actuator_leakage_m3_s_pa"),
        )
