"""What is fitted: the parameters of a plant file that differ from machine to machine, each with its prior.

A fitted number θ is 0 at the plant file's own value. A *factor* multiplies the file's value by e^θ, so that
it cannot change sign and its spread is relative; an *offset* adds θ. Parameters of the state that a recording
begins with (chamber pressures, where a shaft stands in its play) are fitted along, but belong to no file.
"""

import json
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from plant_emulator.config.actuators import BAR
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.layout import EDGES, JOINTS
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from testbed.identification.free_run import Start
from testbed.identification.recording import Array

_STEPS_MS = (0.4, 0.3, 0.2, 0.1)  # [M] 0.45 leaves 0.2 of χ² against 0.2; 0.5 is refused where oil is stiffer
_STIFFER = 1.35  # a fit's bulk modulus, at most, against the file's
_SLOW_SPOOL = 50.0  # 1/s: a spool that is faster shows nothing of its limit
_SMALL = ("leakage", "play", "encoder zero", "mass", "base tilt")
_LINKS = {"boom": ("boom",), "arm": ("arm", "telescope")}
OPENED = {"extend": ("supply_a", "return_b"), "retract": ("supply_b", "return_a")}
Key = tuple[str | int, ...]


class Parameter(NamedTuple):
    """One number to fit: the entries of the plant file that it moves, all alike; ``spread`` of its prior.

    ``joint`` (0 to 5) is the one that it belongs to, None when it belongs to all. ``source`` is the prior's
    provenance. ``least`` and ``most`` bound the entry itself, in its unit.
    """

    name: str
    unit: str
    kind: Literal["factor", "offset"]
    keys: tuple[Key, ...]
    spread: float
    source: str
    joint: int | None = None
    least: float = -np.inf
    most: float = np.inf

    @property
    def is_small(self) -> bool:
        """Whether it shows so little that the first steps of a fit had better leave it alone."""
        return any(word in self.name for word in _SMALL)

    @property
    def of_start(self) -> bool:
        """Whether it describes the recording's beginning and not the machine."""
        return self.name.startswith("start.")


def base_of(config: PlantConfig, period_s: float = 0.01) -> dict[str, Any]:
    """``config`` as plain data to fit: at a step that holds for stiffer oil, a part of ``period_s``."""
    base: dict[str, Any] = json.loads(config.model_dump_json())  # a copy in depth: YAML's aliases are gone
    base["step_ms"] = _step_ms(config, 1e3 * period_s)
    base["valves"]["joints"] = every_valve(config)
    for name in ("encoder_offsets", "base_tilt"):
        if not base["errors"][name]["enabled"]:
            entry = base["errors"][name]
            base["errors"][name] = {key: _with_zeros(value) for key, value in entry.items()} | {
                "enabled": True
            }
    return base


def _step_ms(config: PlantConfig, period_ms: float) -> float:
    stiff = config.oil.model_copy(update={"bulk_modulus_mpa": _STIFFER * config.oil.bulk_modulus_mpa})
    for most in _STEPS_MS:
        step = round(period_ms / math.ceil(period_ms / min(most, config.step_ms) - 1e-6), 9)
        try:
            Plant(config.model_copy(update={"oil": stiff, "step_ms": step}), seed=0)
        except ConfigurationError as error:
            if error.cause != "configuration.unstable_step":
                break
        else:
            break
    return step


def every_valve(config: PlantConfig) -> dict[str, Any]:
    """``valves.joints`` of ``config`` with nothing left to what is common: each entry can be fitted."""
    return {name: _whole_valve(config, joint) for joint, name in enumerate(JOINT_NAMES)}


def _with_zeros(value: Any) -> Any:
    return [0.0] * len(value) if isinstance(value, list) else 0.0


def _whole_valve(config: PlantConfig, joint: int) -> dict[str, Any]:
    """All that there is to a joint's valve, as its entry of the file may tell it."""
    name = JOINT_NAMES[joint]
    actuator = config.actuators.in_order()[joint]
    valve = config.valves.of(name, actuator.rated_flow_l_min)
    own, told = actuator.leakage_m3_s_pa, valve.actuator_leakage_m3_s_pa
    return {
        "bandwidth_hz": valve.bandwidth_hz,
        "damping_ratio": valve.damping_ratio,
        "slew_limit_per_s": {"out": valve.slew_out_per_s, "back": valve.slew_back_per_s},
        "delay_ms": valve.delay_ms,
        "deadband": dict(zip(EDGES, valve.deadband, strict=True)),
        "hysteresis": valve.hysteresis,
        "initial_slope": {"extend": valve.slope_extend, "retract": valve.slope_retract},
        "flow_l_min": {"extend": valve.flow_extend_l_min, "retract": valve.flow_retract_l_min},
        "spool_leakage_m3_s_pa": valve.spool_leakage_m3_s_pa,
        "actuator_leakage_m3_s_pa": own if math.isnan(told) else told,
    }


def parameters_of(config: PlantConfig, joints: Sequence[int]) -> list[Parameter]:
    """The parameters of ``config`` that motions of ``joints`` can tell something of."""
    found = [*_shared_parameters(), *_of_all_valves(joints)]
    for joint in joints:
        found += [*_of_valve(joint), *_of_joint(config, joint)]
    base = base_of(config)
    fast = entry(base, ("valves", "joints", JOINTS[joints[0]], "slew_limit_per_s", "out")) > _SLOW_SPOOL
    straight = entry(base, ("valves", "joints", JOINTS[joints[0]], "initial_slope", "extend")) == 1.0
    left_out = ["valve stroke rate"] * fast + ["valve curve"] * straight
    return [
        p for p in found if p.name not in left_out and (p.kind == "offset" or entry(base, p.keys[0]) > 0.0)
    ]


def _shared_parameters() -> list[Parameter]:
    def masses(link: str) -> tuple[Key, ...]:
        return tuple(("masses", part, "*", "mass_kg") for part in _LINKS[link])

    def bending(link: str) -> tuple[Key, ...]:
        return tuple(("flexibility", link, f"{way}_ei_n_m2") for way in ("vertical", "lateral"))

    oil, load, tilt = ("oil", "bulk_modulus_mpa"), ("payload", "mass_kg"), ("errors", "base_tilt")
    return [
        Parameter("bulk modulus", "MPa", "factor", (oil,), 0.15, "[S] effective, air unknown"),
        Parameter("payload", "kg", "offset", (load,), 60.0, "[D] whatever hangs there", None, 0.0, 1000.0),
        Parameter("boom bending EI", "N m²", "factor", bending("boom"), 0.2, "[E] section from a drawing"),
        Parameter("arm bending EI", "N m²", "factor", bending("arm"), 0.2, "[E] section from a drawing"),
        Parameter("boom mass", "kg", "factor", masses("boom"), 0.02, "[S]"),
        Parameter("arm mass", "kg", "factor", masses("arm"), 0.02, "[S]"),
        Parameter("base tilt about x", "mrad", "offset", ((*tilt, "x_mrad"),), 4.0, "[E]"),
        Parameter("base tilt about y", "mrad", "offset", ((*tilt, "y_mrad"),), 4.0, "[E]"),
    ]


def _of_all_valves(joints: Sequence[int]) -> list[Parameter]:
    """What valves of one make have in common, whose differences are in the file."""

    def every(*parts: str) -> tuple[Key, ...]:
        return tuple(("valves", "joints", JOINTS[j], *parts) for j in joints)

    rates = (*every("slew_limit_per_s", "out"), *every("slew_limit_per_s", "back"))
    curves = (*every("initial_slope", "extend"), *every("initial_slope", "retract"))
    return [
        Parameter("valve bandwidth", "Hz", "factor", every("bandwidth_hz"), 0.2, "[S] for another spool"),
        Parameter("valve delay", "ms", "offset", every("delay_ms"), 0.4, "[E]", None, 0.0, 100.0),
        Parameter("valve stroke rate", "1/s", "factor", rates, 0.2, "[S] a range"),
        Parameter("valve curve", "", "factor", curves, 0.15, "[E]"),
    ]


def _of_valve(joint: int) -> list[Parameter]:
    name = JOINTS[joint]
    part: Key = ("valves", "joints", name)
    found = []
    for way, sign in (("extend", "+"), ("retract", "−")):
        flow = (*part, "flow_l_min", way)
        edges = tuple((*part, "deadband", edge) for edge in OPENED[way])
        found += [
            Parameter(f"{name} rated flow {sign}", "l/min", "factor", (flow,), 0.1, "[S] ±10 %", joint),
            Parameter(
                f"{name} deadband {sign}", "", "factor", edges, 0.3, "[E] lap is on no data sheet", joint
            ),
        ]
    loop = (*part, "hysteresis")
    return [*found, Parameter(f"{name} hysteresis", "", "factor", (loop,), 0.3, "[S] a range", joint)]


def _of_joint(config: PlantConfig, joint: int) -> list[Parameter]:
    name, actuator = JOINTS[joint], config.actuators.in_order()[joint]
    kind, force, rate = (
        ("cylinder", "n", "n_s_m") if actuator.cylinder is not None else ("rotary", "nm", "nm_s_rad")
    )
    unit, unit_rate = ("N", "N s/m") if kind == "cylinder" else ("N m", "N m s/rad")
    friction: Key = ("actuators", name, kind, "friction")
    coulomb = ((*friction, f"coulomb_{force}"), (*friction, f"static_{force}"))  # they scale together
    leak = ("valves", "joints", name, "actuator_leakage_m3_s_pa")
    drag = (*friction, f"viscous_{rate}")
    play: Key = ("errors", "backlash", "half_width_mrad", joint)
    found = [
        Parameter(f"{name} leakage", "m³/s/Pa", "factor", (leak,), 0.5, "[E]", joint),
        Parameter(f"{name} Coulomb", unit, "factor", coulomb, 0.3, "[E]", joint),
        Parameter(f"{name} viscous", unit_rate, "factor", (drag,), 0.3, "[E]", joint),
        Parameter(f"{name} play", "mrad", "factor", (play,), 0.3, "[E]", joint),
    ]
    if joint > 0:  # a turned slew is only a turned frame
        offset: Key = ("errors", "encoder_offsets", "mrad", joint)
        found.append(Parameter(f"{name} encoder zero", "mrad", "offset", (offset,), 3.0, "[E]", joint))
    return found


def start_parameters(
    joints: Sequence[int], angle_std: float, pressure_std: float, half_play: Sequence[float]
) -> list[Parameter]:
    """What is not known exactly of the start: angles (rad) and pressures (Pa) of ``joints`` and of the
    supply, by their spreads, and where the joints stand in their play of ``half_play`` (6,) rad."""

    def start(what: str, unit: str, spread: float, joint: int | None) -> Parameter:
        return Parameter(f"start.{what}", unit, "offset", (), spread, "[M]", joint)

    found = [start("supply", "bar", pressure_std / BAR, None)]
    for j in joints:
        found.append(start(f"angle.{JOINTS[j]}", "mrad", 1e3 * angle_std, j))
        found += [start(f"pressure.{JOINTS[j]}.{side}", "bar", pressure_std / BAR, j) for side in "ab"]
        place = 1e3 * half_play[j] / 3.0**0.5
        if place > 0.0:
            found.append(start(f"play.{JOINTS[j]}", "mrad", place, j))
    return found


def entry(data: Any, key: Key) -> float:
    """The entry of nested ``data`` under ``key``; the first of all where ``key`` says '*'."""
    for part in key:
        data = data[0 if part == "*" else part]
    return float(data)


def value(base: dict[str, Any], parameter: Parameter, theta: float) -> float:
    """The entry that ``parameter`` has in the plant at ``theta``, in its own unit."""
    at = entry(base, parameter.keys[0]) if parameter.keys else 0.0
    return at * float(np.exp(theta)) if parameter.kind == "factor" else at + theta


def changed(base: dict[str, Any], parameters: Sequence[Parameter], theta: Array) -> dict[str, Any]:
    """``base`` with every parameter at its ``theta``; ``base`` stays as it is."""
    data: dict[str, Any] = json.loads(json.dumps(base))
    for parameter, number in zip(parameters, theta, strict=True):
        for key in parameter.keys:
            _change(data, key, parameter, float(number))
    return data


def _change(data: Any, key: Key, parameter: Parameter, theta: float) -> None:
    """Move the entries of nested ``data`` under ``key``, in place."""
    first, *rest = key
    if first == "*":
        for item in data:
            _change(item, tuple(rest), parameter, theta)
    elif rest:
        _change(data[first], tuple(rest), parameter, theta)
    elif parameter.kind == "factor":
        data[first] *= float(np.exp(theta))
    else:
        data[first] = min(max(data[first] + theta, parameter.least), parameter.most)


def moved_start(start: Start, parameters: Sequence[Parameter], theta: Array) -> Start:
    """``start`` with the parameters of the start at their ``theta``."""
    angles, pressures, in_play = start.angles.copy(), start.pressures.copy(), start.in_play.copy()
    supply = start.supply
    for parameter, number in zip(parameters, theta, strict=True):
        if not parameter.of_start:
            continue
        if parameter.joint is None:
            supply += number * BAR
        elif parameter.name.startswith("start.angle"):
            angles[parameter.joint] += number * 1e-3
        elif parameter.name.startswith("start.pressure"):
            pressures[parameter.joint, "ab".index(parameter.name[-1])] += number * BAR
        else:
            in_play[parameter.joint] += number * 1e-3
    return start._replace(angles=angles, pressures=pressures, supply=supply, in_play=in_play)
