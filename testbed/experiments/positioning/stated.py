"""What commissioning would tell of a drawn machine: drawn around the truth, as far off as it is told.

In place of a commissioning that is run, where a campaign cannot spend its six minutes of arm time on every
machine. Every number is off by a normal error of the spread that the file states; which σ commissioning
states is that of ``longreach experiment commissioning``. Rows made with it say ``stated``.
"""

import math

import numpy as np

from controller.commissioning import basis_of
from nominal_arm.commissioned import (
    CURVE_KNOTS,
    Commissioned,
    JointPlay,
    JointTuning,
    JointValve,
    MeasuredNumber,
    ValveEdge,
    ValveSet,
)
from nominal_arm.description import CylinderDrive, Drive
from plant_emulator.config.actuators import ActuatorConfig
from plant_emulator.config.units import LITRE_PER_MINUTE
from plant_emulator.config.valves import JOINT_NAMES, Valve
from testbed.commissioning.margins import MARGINS, gain_within
from testbed.scenarios.settings import Settings

STATED = "drawn around the truth, not commissioned"
_STREAM = 0x73746174
_DEADBAND, _LOOP, _GAIN, _DELAY, _PLAY = 0.01, 0.05, 0.02, 0.1, 0.1  # [E] σ of each, of itself
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
    half = plant.errors.backlash.half_width_mrad
    play = {name: _number(rng, value, _PLAY) for name, value in zip(JOINT_NAMES, half, strict=True)}
    return Commissioned(
        made_utc="2026-01-01T00:00:00+00:00",
        made_by=STATED,
        basis=basis_of(settings.arm, settings.controller),
        valves=known,
        tuning=tuned_gains(known, settings),
        play_mrad=JointPlay(**play),
    )


def tuned_gains(known: ValveSet, settings: Settings) -> JointTuning:
    """Gains lowered to the margins that commissioning keeps, at the lag that is stated."""
    control = settings.controller.joint_control
    filtered, gains = 1e-3 * control.pt1_time_constant_ms, list(control.gain_1_s)
    for joint, valve in enumerate(known.joints):
        lag_s = 1e-3 * (valve.delay_ms.value + valve.lag_ms.value + settings.controller.cycle_ms)
        gains[joint] = gain_within(gains[joint], lag_s, filtered if joint in (1, 2) else 0.0, MARGINS)
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
    rng: np.random.Generator | None, valve: Valve, gains: tuple[float, float], before: JointValve
) -> JointValve:
    """Both directions; on both arms a piston that extends raises its joint. No ``rng``: without error."""
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


def _edge(rng: np.random.Generator | None, overlap: float, gain: float, slope: float) -> ValveEdge:
    """The flow curve is slope · s + (1 − slope) · s² of the share s of the spool's way that is left."""
    way = 1.0 - overlap
    curve = tuple((float(x), float(x + (1.0 / slope - 1.0) * x * x / way)) for x in _KNOTS)
    return ValveEdge(
        deadband=_number(rng, overlap, _DEADBAND, _LEAST),
        flow_gain=_number(rng, gain * slope / way if slope != 1.0 else gain, _GAIN),
        curve=curve if slope != 1.0 else (),
    )


def _number(rng: np.random.Generator | None, true: float, share: float, least: float = 0.0) -> MeasuredNumber:
    std = max(share * abs(true), least)
    error = 0.0 if rng is None else float(rng.standard_normal())
    return MeasuredNumber(value=max(true + std * error, 0.0), std=std)
