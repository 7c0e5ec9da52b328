"""The worlds by name: what each draws beside the task, what is demanded, what commissioning would tell.

``lab`` is the laboratory that the method was built in: servo valves that are known, a good camera. ``real``
draws everything in which one machine differs from the next, so its machines are emulated degraded ones;
``crane-real`` the same on the 10 m crane.
"""

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from controller.commissioning import basis_of
from foundation.configuration import merged
from laboratory.experiments.positioning import axes, axes_of_sight
from laboratory.experiments.positioning.axes import Axis
from nominal_arm.commissioned import (
    CURVE_KNOTS,
    Commissioned,
    JointTuning,
    JointValve,
    MeasuredNumber,
    ValveEdge,
    ValveSet,
)
from nominal_arm.description import CylinderDrive, Drive
from plant_emulator.config.actuators import LITRE_PER_MINUTE, ActuatorConfig
from plant_emulator.config.valves import JOINT_NAMES, Valve
from testbed.commissioning.findings import greatest_gain
from testbed.lockstep.simulated_measurements import EyeCondition
from testbed.scenarios.scenario import Settings

ARMS = ("plant", "plant_long_crane")


class Demands(NamedTuple):
    """What is asked of a world's rows; None: a figure is for information."""

    one_look: float | None = None
    two_looks: float | None = None
    open_loop: float | None = None
    median_mm: float | None = None
    q95_mm: float | None = None


class DrawnWorld(NamedTuple):
    """What is drawn beside the task, on which arm, with which condition of the eye model, what is asked."""

    axes: tuple[Axis, ...]
    demands: Demands
    eyes: EyeCondition
    arm: str = ARMS[0]


class WorldName(StrEnum):
    """What differs from machine to machine."""

    LAB = "lab"
    REAL = "real"
    CRANE_REAL = "crane-real"


_LAB = (axes_of_sight.principal_point,)
_REAL = (
    axes.mobile_valves,
    axes.load_holding,
    axes.friction,
    axes.bending,
    axes.finer_bending,
    axes.play,
    axes.loose_slew,
    axes.tilting_bearing,
    axes.torsion,
    axes.soft_pins,
    axes.eccentric_encoders,
    axes.rocking_base,
    axes.payload_off_axis,
    axes.joint_axes,
    axes.oil,
    axes.cooling_oil,
    axes.supply,
    axes_of_sight.rectification,
    axes_of_sight.lens,
    axes_of_sight.principal_point,
    axes_of_sight.two_lenses,
    axes_of_sight.drift,
    axes_of_sight.stamps,
    axes_of_sight.light,
    axes_of_sight.rolling_shutter,
    axes_of_sight.exposure,
    axes_of_sight.moving_shadow,
    axes_of_sight.uneven_wall,
    axes_of_sight.broken_wall,
    axes_of_sight.passers,
    axes_of_sight.tool_print,
    axes_of_sight.object_markers,
)

_LAB_DEMANDS = Demands(0.98, None, open_loop=0.90, median_mm=1.5, q95_mm=3.0)
_REAL_DEMANDS = Demands(0.95, 0.99, q95_mm=3.5)
_CRANE_DEMANDS = Demands(0.90, 0.97, q95_mm=3.5)

WORLDS: Mapping[WorldName, DrawnWorld] = {
    WorldName.LAB: DrawnWorld(_LAB, _LAB_DEMANDS, "usual"),
    WorldName.REAL: DrawnWorld(_REAL, _REAL_DEMANDS, "harder"),
    WorldName.CRANE_REAL: DrawnWorld(_REAL, _CRANE_DEMANDS, "harder", ARMS[1]),
}


def drawn(world: DrawnWorld, seed: int, stream: int, usual: Settings) -> dict[str, Any]:
    """The overrides (file name → nested keys) of all the world's axes, each from a stream of its own.

    ``stream`` tells apart what else is drawn from the same ``seed``; ``usual`` is what the axes lie over.
    """
    overrides: dict[str, Any] = {}
    for axis in world.axes:
        rng = np.random.default_rng([seed, stream, crc32(axis.name.encode())])
        overrides = merged(overrides, axis.draw(rng, usual))
    return overrides


STATED = "drawn around the truth, not commissioned"
_STREAM = 0x73746174
_DEADBAND, _LOOP, _GAIN, _DELAY = 0.01, 0.05, 0.02, 0.1  # [E] σ of each, of itself
_LEAST = 1e-4  # of spool
_KNOTS = np.linspace(0.0, 0.8, CURVE_KNOTS + 1)[1:]


def stated_commissioning(settings: Settings, seed: int) -> Commissioned:
    """The file for the machine of ``settings``; the same ``seed`` errs alike."""
    rng = np.random.default_rng([seed, _STREAM])
    plant, before = settings.plant, settings.controller.valves
    compensated = plant.valves.compensator_bar > 0.0
    valves = {}
    for name, drive in zip(JOINT_NAMES, settings.arm.drives, strict=True):
        actuator = getattr(plant.actuators, name)
        valve = plant.valves.of(name, actuator.rated_flow_l_min)
        gains = full_flow(valve, actuator, drive) if compensated else (1.0, 1.0)
        valves[name] = stated_valve(rng, valve, gains, getattr(before, name))
    known = ValveSet(name=before.name, pressure_compensated=compensated, **valves)
    return Commissioned(
        made_utc="2026-01-01T00:00:00+00:00",
        made_by=STATED,
        basis=basis_of(settings.arm, settings.controller),
        valves=known,
        tuning=tuned_gains(known, settings),
    )


def tuned_gains(known: ValveSet, settings: Settings) -> JointTuning:
    """Gains lowered to the margins that commissioning keeps, at the lag that is stated."""
    control = settings.controller.joint_control
    filtered, gains = 1e-3 * control.pt1_time_constant_ms, list(control.gain_1_s)
    for joint, valve in enumerate(known.joints):
        lag_s = 1e-3 * (valve.delay_ms.value + valve.lag_ms.value + settings.controller.cycle_ms)
        gains[joint] = min(gains[joint], greatest_gain(lag_s, filtered if joint in (1, 2) else 0.0))
    a, b, c, d, e, f = gains
    return JointTuning(gain_1_s=(a, b, c, d, e, f))


def full_flow(valve: Valve, actuator: ActuatorConfig, drive: Drive) -> tuple[float, float]:
    """Speed at full spool over the nominal one, out and back, where flow does not depend on the load."""
    out, back = (flow * LITRE_PER_MINUTE for flow in (valve.flow_extend_l_min, valve.flow_retract_l_min))
    if isinstance(drive, CylinderDrive):
        assert actuator.cylinder is not None
        bore, rod = (1e-3 * width for width in (actuator.cylinder.bore_mm, actuator.cylinder.rod_mm))
        wide, narrow = 0.25 * math.pi * bore**2, 0.25 * math.pi * (bore**2 - rod**2)
        return out / wide / drive.extend_m_s, back / narrow / drive.retract_m_s
    assert actuator.rotary is not None
    volume = actuator.rotary.displacement_m3_rad
    return out / volume / drive.speed_rad_s, back / volume / drive.speed_rad_s


def stated_valve(
    rng: np.random.Generator, valve: Valve, gains: tuple[float, float], before: JointValve
) -> JointValve:
    """Both directions; on both arms a piston that extends raises its joint."""
    supply_a, return_b, supply_b, return_a = valve.deadband
    slopes = valve.slope_extend, valve.slope_retract
    overlaps = max(supply_a, return_b), max(supply_b, return_a)
    raising, lowering = (
        _edge(rng, overlap, gain, slope) for overlap, gain, slope in zip(overlaps, gains, slopes, strict=True)
    )
    lag_ms = 1e3 * 2.0 * valve.damping_ratio / (2.0 * math.pi * valve.bandwidth_hz)
    return JointValve(
        raising=raising,
        lowering=lowering,
        hysteresis=_number(rng, valve.hysteresis, _LOOP, _LEAST),
        delay_ms=_number(rng, valve.delay_ms, _DELAY, 1.0),
        lag_ms=_number(rng, lag_ms, _DELAY),
        full_stroke_ms=before.full_stroke_ms,
    )


def _edge(rng: np.random.Generator, overlap: float, gain: float, slope: float) -> ValveEdge:
    """The flow curve is slope · s + (1 − slope) · s² of the share s of the spool's way that is left."""
    way = 1.0 - overlap
    curve = tuple((float(x), float(x + (1.0 / slope - 1.0) * x * x / way)) for x in _KNOTS)
    return ValveEdge(
        deadband=_number(rng, overlap, _DEADBAND, _LEAST),
        flow_gain=_number(rng, gain * slope / way if slope != 1.0 else gain, _GAIN),
        curve=curve if slope != 1.0 else (),
    )


def _number(rng: np.random.Generator, true: float, share: float, least: float = 0.0) -> MeasuredNumber:
    std = max(share * abs(true), least)
    return MeasuredNumber(value=max(true + std * float(rng.standard_normal()), 0.0), std=std)
