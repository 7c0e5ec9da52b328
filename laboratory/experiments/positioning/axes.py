"""What differs from one machine to the next, each as an axis: how it is drawn, how wide, and why so wide.

What the camera sees, and how, is in ``axes_of_sight``.

An axis turns a generator and the configuration that it lies over into overrides of ``plant`` and ``scene``.
It never touches what controller or vision are told. Every axis has a stream of random numbers of its own, so
that another one beside it leaves its draws as they were.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.layout import EDGES
from testbed.scenarios.scenario import Settings

JSON = dict[str, Any]
Draw = Callable[[np.random.Generator, Settings], JSON]


class Axis(NamedTuple):
    """One thing that is drawn: ``width`` in words, and ``source``, its provenance as in the configuration."""

    name: str
    width: str
    source: str
    draw: Draw


def axis(width: str, source: str) -> Callable[[Draw], Axis]:
    """The axis of a function: its name is the function's."""
    return lambda draw: Axis(draw.__name__, width, source, draw)


Value = Callable[[np.random.Generator, Any], Any]
"""One value: from a generator and what it is usually."""


def between(low: Any, high: Any) -> Value:
    """Evenly between two bounds; of arrays, each between its own."""
    return lambda rng, _usual: np.asarray(rng.uniform(low, high)).tolist()


def times(most: float) -> Value:
    """The usual value, at most so many times as large or as small."""
    return lambda rng, usual: usual * factor(rng, most)


def values(name: str, width: str, source: str, place: str, **drawn: Any) -> Axis:
    """The axis of values that lie at one place of the configuration; what is no function stays as it is."""
    keys = place.split(".")

    def draw(rng: np.random.Generator, usual: Settings) -> JSON:
        there = reduce(getattr, keys, usual)
        made = {
            key: value(rng, getattr(there, key, None)) if callable(value) else value
            for key, value in drawn.items()
        }
        return reduce(lambda inner, key: {key: inner}, reversed(keys), made)

    return Axis(name, width, source, draw)


def about(rng: np.random.Generator, value: float, share: float) -> float:
    """``value`` times 1 ± ``share``, evenly."""
    return value * (1.0 + rng.uniform(-share, share))


def factor(rng: np.random.Generator, most: float) -> float:
    """Between 1 / ``most`` and ``most``, evenly in its logarithm."""
    return float(most ** rng.uniform(-1.0, 1.0))


# ---- the machine


@axis(
    "overlap ±25 % an edge, flow ±10 % a direction, hysteresis 2 to 7 %, delay ±30 %, spool's loop ±20 %",
    "[S] data sheets of mobile valves: overlap 5 to 12 %, hysteresis 2 to 7 %, flow ±10 %; [E] the rest",
)
def mobile_valves(rng: np.random.Generator, usual: Settings) -> JSON:
    """Mobile proportional valves with load-holding valves, around the set in plant.yaml."""
    spools = usual.plant.valve_sets["mobile"]
    drawn = {}
    for name in JOINT_NAMES:
        valve = spools.of(name, getattr(usual.plant.actuators, name).rated_flow_l_min)
        edges = zip(EDGES, valve.deadband, strict=True)
        drawn[name] = {
            "deadband": {edge: about(rng, overlap, 0.25) for edge, overlap in edges},
            "hysteresis": rng.uniform(0.02, 0.07),
            "delay_ms": about(rng, valve.delay_ms, 0.3),
            "bandwidth_hz": about(rng, valve.bandwidth_hz, 0.2),
            "flow_l_min": {
                "extend": about(rng, valve.flow_extend_l_min, 0.1),
                "retract": about(rng, valve.flow_retract_l_min, 0.1),
            },
        }
    return {"plant": {"valve_set": "mobile", "valves": {"joints": drawn}}}


@axis(
    "set to 240 to 280 bar, pilot ratio 2.7 to 6, opening range ×0.8 to 1.25, pilot's lag ×0.7 to 1.4",
    "[S] data sheets: ratios of 3, 4.5 and more, set at least 1.3 times above the load; [E] range and lag",
)
def load_holding(rng: np.random.Generator, usual: Settings) -> JSON:
    """The counterbalance valves of lift and tilt."""
    hold = usual.plant.valve_sets["mobile"].counterbalance
    drawn = {
        "setting_bar": rng.uniform(240.0, 280.0),
        "pilot_ratio": 4.0 * factor(rng, 1.5),
        "range_bar": hold.range_bar * factor(rng, 1.25),
        "lag_ms": hold.lag_ms * factor(rng, 1.4),
    }
    return {"plant": {"valves": {"counterbalance": drawn}}}


@axis("×0.6 to 1.7 for each actuator", "[E] seals: wear, pressure and temperature")
def friction(rng: np.random.Generator, usual: Settings) -> JSON:
    """Coulomb, static and viscous friction of an actuator, by one factor: it is the same seal."""
    drawn = {}
    for name, actuator in usual.plant.actuators:
        kind = "cylinder" if actuator.cylinder is not None else "rotary"
        parts = getattr(actuator, kind).friction.model_dump()
        wear = factor(rng, 1.7)
        wet = {key: wear * value for key, value in parts.items() if key.startswith(_RUBBING)}
        drawn[name] = {kind: {"friction": wet}}
    return {"plant": {"actuators": drawn}}


_RUBBING = ("coulomb", "static", "viscous")


@axis("EI ×0.67 to 1.5, boom and arm apart", "[E] section drawings, welds, pads of the telescope")
def bending(rng: np.random.Generator, usual: Settings) -> JSON:
    """How stiff the booms are."""
    drawn: JSON = {}
    for name in ("boom", "arm"):
        beam, stiff = getattr(usual.plant.flexibility, name), factor(rng, 1.5)
        drawn[name] = {
            "vertical_ei_n_m2": stiff * beam.vertical_ei_n_m2,
            "lateral_ei_n_m2": stiff * beam.lateral_ei_n_m2,
        }
    return {"plant": {"flexibility": drawn}}


# Where the booms bend.
finer_bending = values(
    "finer_bending",
    "two hinges a beam each way, at 0.25 to 0.3 and 0.6 to 0.7 of it",
    "[E] sections of unequal strength; [D] no longer the estimator's own model, one hinge at a third",
    "plant.errors.finer_bending",
    enabled=True,
    boom_at=between([0.25, 0.6], [0.3, 0.7]),
    arm_at=between([0.25, 0.6], [0.3, 0.7]),
)


# Between joints and their encoders.
play = values(
    "play",
    "half: slew 0.1 to 0.7 mrad, lift and tilt 0.03 to 0.3, wrist 0.05 to 0.3",
    "[S] mesh backlash 0.18 to 0.23 mm of a rotary actuator on 0.1 to 0.25 m: 0.4 to 1.1 mrad half; "
    "[E] pins worn by 0.01 to 0.1 mm on 0.31 m",
    "plant.errors.backlash",
    half_width_mrad=between([0.1, 0.03, 0.03, 0.05, 0.05, 0.05], [0.7, 0.3, 0.3, 0.3, 0.3, 0.3]),
)


@axis("0 to 0.3 m off the tool's axis", "[E] a drill or a gripper hangs beside the wrist")
def payload_off_axis(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Where the payload's centre is."""
    angle, reach = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 0.3)
    across, up = (reach * np.array([np.cos(angle), np.sin(angle)])).tolist()
    return {"plant": {"payload": {"centre_m": [0.0, across, up]}}}


@axis(
    "tilt of lift, tilt and wrist 1 ±2 mrad; place of wrist 2, wrist 3 and tool ±1 mm",
    "[E] welded booms, a machined wrist; beside the lab's draws of lift, tilt, wrist 1 and tool",
)
def joint_axes(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Geometry that the lab leaves as it stands in plant.yaml."""
    drawn = {name: {"tilt_mrad": rng.uniform(-2.0, 2.0, 3).tolist()} for name in ("lift", "tilt", "wrist1")}
    for name in ("wrist2", "wrist3", "tool"):
        drawn[name] = {"offset_mm": rng.uniform(-1.0, 1.0, 3).tolist()}
    return {"plant": {"errors": {"geometry": drawn}}}


# The state of the oil.
oil = values(
    "oil",
    "20 to 60 °C; 0.2 to 2 % of air; bulk modulus ×0.7 to 1",
    "[E] a cold morning, a hot afternoon, old oil; [D] no stiffer: 0.5 ms is the longest stable step",
    "plant.oil",
    temperature_degc=between(20.0, 60.0),
    air_fraction=lambda rng, _usual: float(np.exp(rng.uniform(np.log(0.002), np.log(0.02)))),
    bulk_modulus_mpa=lambda rng, usual: usual * rng.uniform(0.7, 1.0),
)


# Oil that shrinks behind shut valves as it cools to the air around.
cooling_oil = values(
    "cooling_oil",
    "time constant ×0.67 to 1.5",
    "[E] wind, paint, how much steel there is to a litre",
    "plant.errors.cooling_oil",
    enabled=True,
    time_constant_s=times(1.5),
)


# The pump's set pressure.
supply = values(
    "supply",
    "±3 %",
    "[E] a gauge of class 1.6 and its zero",
    "plant.pump",
    pressure_bar=lambda rng, usual: about(rng, usual, 0.03),
)


# Encoders off the centre of their shafts.
eccentric_encoders = values(
    "eccentric_encoders",
    "0.2 to 0.5 mrad once a turn, for each joint",
    "[E] of a real shaft",
    "plant.errors.encoder_eccentricity",
    enabled=True,
    mrad=between([0.2] * 6, [0.5] * 6),
    phase_deg=between([0.0] * 6, [360.0] * 6),
)


# How the booms twist.
torsion = values(
    "torsion",
    "G J ×0.67 to 1.5, boom and arm apart",
    "[E] as the bending",
    "plant.errors.torsion",
    enabled=True,
    boom_gj_n_m2=times(1.5),
    arm_gj_n_m2=times(1.5),
)


# How the pivots' pins give.
soft_pins = values(
    "soft_pins",
    "stiffness ×0.5 to 2, lift and tilt apart",
    "[E] pins in worn bushes",
    "plant.errors.pin_compliance",
    enabled=True,
    lift_nm_rad=times(2.0),
    tilt_nm_rad=times(2.0),
)


# The slewing ring's axial play.
tilting_bearing = values(
    "tilting_bearing",
    "0.3 to 0.6 mm over the ring",
    "[S] a new slewing ring",
    "plant.errors.bearing_tilt",
    enabled=True,
    play_mm=between(0.3, 0.6),
)


# Play in the slew's mesh, as loose steel.
loose_slew = values(
    "loose_slew",
    "0.7 to 2.3 mrad to and fro; hoses pull by up to 80 N m",
    "[S] 0.18 to 0.23 mm of mesh; [E] on 0.1 to 0.25 m, hoses",
    "plant.errors.loose_slew",
    enabled=True,
    backlash_mrad=between(0.7, 2.3),
    hose_nm=lambda rng, usual: rng.uniform(-2.0 * usual, 2.0 * usual),
)


@axis(
    "1.5 to 4 Hz about each axis, damping 2 to 5 %; engine and pump ×0.5 to 2",
    "[E] a truck on its outriggers",
)
def rocking_base(rng: np.random.Generator, usual: Settings) -> JSON:
    """A carrier that rocks, shaken by its engine and pump."""
    rocks = {"frequency_hz": rng.uniform(1.5, 4.0, 3).tolist(), "damping_ratio": rng.uniform(0.02, 0.05)}
    drawn: JSON = {"rocking_base": {"enabled": True} | rocks, "vibration": {"enabled": True}}
    for name in ("engine", "pump"):
        strength = factor(rng, 2.0)
        moments = getattr(usual.plant.errors.vibration, name).moment_nm
        drawn["vibration"][name] = {"moment_nm": [strength * moment for moment in moments]}
    return {"plant": {"errors": drawn}}
