"""What differs from one machine to the next, each as an axis: how it is drawn, how wide, and why so wide.

An axis turns a generator and the configuration that it lies over into overrides of ``plant`` and ``scene``.
It never touches what controller or vision are told. Every axis has a stream of random numbers of its own, so
that another one beside it leaves its draws as they were.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from plant_emulator.config.valves import JOINT_NAMES
from testbed.scenarios.settings import Settings

JSON = dict[str, Any]
Draw = Callable[[np.random.Generator, Settings], JSON]


class Axis(NamedTuple):
    """One thing that is drawn: ``width`` in words, and ``source``, its provenance as in the configuration."""

    name: str
    width: str
    source: str
    draw: Draw


def _axis(width: str, source: str) -> Callable[[Draw], Axis]:
    """The axis of a function: its name is the function's."""
    return lambda draw: Axis(draw.__name__, width, source, draw)


def _about(rng: np.random.Generator, value: float, share: float) -> float:
    """``value`` times 1 ± ``share``, evenly."""
    return value * (1.0 + rng.uniform(-share, share))


def _factor(rng: np.random.Generator, most: float) -> float:
    """Between 1 / ``most`` and ``most``, evenly in its logarithm."""
    return float(most ** rng.uniform(-1.0, 1.0))


# ---- the machine


@_axis(
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
            "deadband": {edge: _about(rng, overlap, 0.25) for edge, overlap in edges},
            "hysteresis": rng.uniform(0.02, 0.07),
            "delay_ms": _about(rng, valve.delay_ms, 0.3),
            "bandwidth_hz": _about(rng, valve.bandwidth_hz, 0.2),
            "flow_l_min": {
                "extend": _about(rng, valve.flow_extend_l_min, 0.1),
                "retract": _about(rng, valve.flow_retract_l_min, 0.1),
            },
        }
    return {"plant": {"valve_set": "mobile", "valves": {"joints": drawn}}}


EDGES = ("supply_a", "return_b", "supply_b", "return_a")


@_axis("×0.6 to 1.7 for each actuator", "[E] seals: wear, pressure and temperature")
def friction(rng: np.random.Generator, usual: Settings) -> JSON:
    """Coulomb, static and viscous friction of an actuator, by one factor: it is the same seal."""
    drawn = {}
    for name, actuator in usual.plant.actuators:
        kind = "cylinder" if actuator.cylinder is not None else "rotary"
        parts = getattr(actuator, kind).friction.model_dump()
        factor = _factor(rng, 1.7)
        wet = {key: factor * value for key, value in parts.items() if key.startswith(_RUBBING)}
        drawn[name] = {kind: {"friction": wet}}
    return {"plant": {"actuators": drawn}}


_RUBBING = ("coulomb", "static", "viscous")


@_axis("EI ×0.67 to 1.5, boom and arm apart", "[E] section drawings, welds, pads of the telescope")
def bending(rng: np.random.Generator, usual: Settings) -> JSON:
    """How stiff the booms are."""
    drawn: JSON = {}
    for name in ("boom", "arm"):
        beam, factor = getattr(usual.plant.flexibility, name), _factor(rng, 1.5)
        drawn[name] = {
            "vertical_ei_n_m2": factor * beam.vertical_ei_n_m2,
            "lateral_ei_n_m2": factor * beam.lateral_ei_n_m2,
        }
    return {"plant": {"flexibility": drawn}}


@_axis(
    "half: slew 0.1 to 0.7 mrad, lift and tilt 0.03 to 0.3, wrist 0.05 to 0.3",
    "[S] mesh backlash 0.18 to 0.23 mm of a rotary actuator on 0.1 to 0.25 m: 0.4 to 1.1 mrad half; "
    "[E] pins worn by 0.01 to 0.1 mm on 0.31 m",
)
def play(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Between joints and their encoders."""
    wide = np.array([0.7, 0.3, 0.3, 0.3, 0.3, 0.3])
    narrow = np.array([0.1, 0.03, 0.03, 0.05, 0.05, 0.05])
    return {"plant": {"errors": {"backlash": {"half_width_mrad": rng.uniform(narrow, wide).tolist()}}}}


@_axis(
    "slew 0.5, lift and tilt 0.25, wrist 0.5 mrad half; not drawn", "[S] the study's 0.5 mrad of joint ripple"
)
def wide_play(_rng: np.random.Generator, _usual: Settings) -> JSON:
    """The harder world's play."""
    play = {"half_width_mrad": [0.5, 0.25, 0.25, 0.5, 0.5, 0.5]}
    return {"plant": {"errors": {"backlash": play}}}


@_axis("0 to 0.3 m off the tool's axis", "[E] a drill or a gripper hangs beside the wrist")
def payload_off_axis(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Where the payload's centre is."""
    angle, reach = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 0.3)
    across, up = (reach * np.array([np.cos(angle), np.sin(angle)])).tolist()
    return {"plant": {"payload": {"centre_m": [0.0, across, up]}}}


@_axis(
    "tilt of lift, tilt and wrist 1 ±2 mrad; place of wrist 2, wrist 3 and tool ±1 mm",
    "[E] welded booms, a machined wrist; beside the lab's draws of lift, tilt, wrist 1 and tool",
)
def joint_axes(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Geometry that the lab leaves as it stands in plant.yaml."""
    drawn = {name: {"tilt_mrad": rng.uniform(-2.0, 2.0, 3).tolist()} for name in ("lift", "tilt", "wrist1")}
    for name in ("wrist2", "wrist3", "tool"):
        drawn[name] = {"offset_mm": rng.uniform(-1.0, 1.0, 3).tolist()}
    return {"plant": {"errors": {"geometry": drawn}}}


@_axis(
    "20 to 60 °C; 0.2 to 2 % of air; bulk modulus ×0.7 to 1",
    "[E] a cold morning, a hot afternoon, old oil; [D] no stiffer: 0.5 ms is the longest stable step",
)
def oil(rng: np.random.Generator, usual: Settings) -> JSON:
    """The state of the oil."""
    drawn = {
        "temperature_degc": rng.uniform(20.0, 60.0),
        "air_fraction": float(np.exp(rng.uniform(np.log(0.002), np.log(0.02)))),
        "bulk_modulus_mpa": usual.plant.oil.bulk_modulus_mpa * rng.uniform(0.7, 1.0),
    }
    return {"plant": {"oil": drawn}}


@_axis("±3 %", "[E] a gauge of class 1.6 and its zero")
def supply(rng: np.random.Generator, usual: Settings) -> JSON:
    """The pump's set pressure."""
    return {"plant": {"pump": {"pressure_bar": _about(rng, usual.plant.pump.pressure_bar, 0.03)}}}


@_axis("0.2 to 0.5 mrad once a turn, for each joint", "[E] of a real shaft")
def eccentric_encoders(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Encoders off the centre of their shafts."""
    drawn = {"enabled": True, "mrad": rng.uniform(0.2, 0.5, 6).tolist()}
    return {
        "plant": {
            "errors": {"encoder_eccentricity": drawn | {"phase_deg": rng.uniform(0.0, 360.0, 6).tolist()}}
        }
    }


@_axis("G J ×0.67 to 1.5, boom and arm apart", "[E] as the bending")
def torsion(rng: np.random.Generator, usual: Settings) -> JSON:
    """How the booms twist."""
    of = usual.plant.errors.torsion
    drawn = {
        "boom_gj_n_m2": of.boom_gj_n_m2 * _factor(rng, 1.5),
        "arm_gj_n_m2": of.arm_gj_n_m2 * _factor(rng, 1.5),
    }
    return {"plant": {"errors": {"torsion": {"enabled": True} | drawn}}}


@_axis("stiffness ×0.5 to 2, lift and tilt apart", "[E] pins in worn bushes")
def soft_pins(rng: np.random.Generator, usual: Settings) -> JSON:
    """How the pivots' pins give."""
    of = usual.plant.errors.pin_compliance
    drawn = {
        "lift_nm_rad": of.lift_nm_rad * _factor(rng, 2.0),
        "tilt_nm_rad": of.tilt_nm_rad * _factor(rng, 2.0),
    }
    return {"plant": {"errors": {"pin_compliance": {"enabled": True} | drawn}}}


@_axis("0.3 to 0.6 mm over the ring", "[S] a new slewing ring")
def tilting_bearing(rng: np.random.Generator, _usual: Settings) -> JSON:
    """The slewing ring's axial play."""
    return {"plant": {"errors": {"bearing_tilt": {"enabled": True, "play_mm": rng.uniform(0.3, 0.6)}}}}


@_axis(
    "0.7 to 2.3 mrad to and fro; hoses pull by up to 80 N m",
    "[S] 0.18 to 0.23 mm of mesh; [E] on 0.1 to 0.25 m, hoses",
)
def loose_slew(rng: np.random.Generator, usual: Settings) -> JSON:
    """Play in the slew's mesh, as loose steel."""
    most = 80.0 * usual.plant.errors.loose_slew.hose_nm / 40.0
    drawn = {"backlash_mrad": rng.uniform(0.7, 2.3), "hose_nm": rng.uniform(-most, most)}
    return {"plant": {"errors": {"loose_slew": {"enabled": True} | drawn}}}


@_axis(
    "1.5 to 4 Hz about each axis, damping 2 to 5 %; engine and pump ×0.5 to 2",
    "[E] a truck on its outriggers",
)
def rocking_base(rng: np.random.Generator, usual: Settings) -> JSON:
    """A carrier that rocks, shaken by its engine and pump."""
    rocks = {"frequency_hz": rng.uniform(1.5, 4.0, 3).tolist(), "damping_ratio": rng.uniform(0.02, 0.05)}
    drawn: JSON = {"rocking_base": {"enabled": True} | rocks, "vibration": {"enabled": True}}
    for name in ("engine", "pump"):
        factor = _factor(rng, 2.0)
        moments = getattr(usual.plant.errors.vibration, name).moment_nm
        drawn["vibration"][name] = {"moment_nm": [factor * moment for moment in moments]}
    return {"plant": {"errors": drawn}}


# ---- the camera


@_axis(
    "disparity ±3.5 px, rows ±1 px",
    "[S] zed-sdk 44: a ZED from the factory showed 12 m as 25 m: 3.5 px; [E] rows",
)
def rectification(rng: np.random.Generator, _usual: Settings) -> JSON:
    """What the maker's calibration leaves."""
    drawn = {"disparity_px": rng.uniform(-3.5, 3.5), "vertical_px": rng.uniform(-1.0, 1.0)}
    return {"scene": {"camera": {"rectification": drawn}}}


@_axis("baseline ±0.6 %, focal length ±0.3 %, k1 ±0.006", "[S] the study's scale of ±0.6 %; [E] the lens")
def lens(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Scale and residual distortion, alike in both eyes."""
    focal = 530.0 * (1.0 + rng.uniform(-0.003, 0.003))
    drawn = {
        "baseline_m": 0.12 * (1.0 + rng.uniform(-0.006, 0.006)),
        "lens": {"fx_px": focal, "fy_px": focal, "k1": rng.uniform(-0.006, 0.006)},
    }
    return {"scene": {"camera": drawn}}


@_axis("noise 4 grey levels, the wall's contrast 12; not drawn", "[E] poor light, a smooth wall")
def poor_light(_rng: np.random.Generator, _usual: Settings) -> JSON:
    """Pictures in which odometry drifts."""
    return {"scene": {"camera": {"noise_grey": 4.0}, "wall": {"contrast_grey": 12.0}}}


@_axis(
    "noise 2 to 5 grey levels, blur 0.5 to 1.0 px, exposure ×0.6 to 1.6, contrast 10 to 25",
    "[E] of a ZED 2 in a hall and outdoors",
)
def light(rng: np.random.Generator, _usual: Settings) -> JSON:
    """What light and focus make of pictures; without pictures, the eye model's condition stands for it."""
    camera = {
        "noise_grey": rng.uniform(2.0, 5.0),
        "blur_px": rng.uniform(0.5, 1.0),
        "exposure_gain": _factor(rng, 1.6),
    }
    return {"scene": {"camera": camera, "wall": {"contrast_grey": rng.uniform(10.0, 25.0)}}}


@_axis("15.7 µs a row, 11.3 ms in all; not drawn", "[S] Stereolabs support: the ZED 2 at 720p and 60 Hz")
def rolling_shutter(_rng: np.random.Generator, _usual: Settings) -> JSON:
    """The ZED 2's readout."""
    return {"scene": {"camera": {"shutter": {"kind": "rolling", "mode_hz": 60}}}}


@_axis("0 to 8 mm over 0.5 to 2 m", "[E] shotcrete and rough concrete")
def uneven_wall(rng: np.random.Generator, _usual: Settings) -> JSON:
    """How far the wall rises and falls about its plane."""
    wall = {"undulation_mm": rng.uniform(0.0, 8.0), "undulation_length_m": rng.uniform(0.5, 2.0)}
    return {"scene": {"wall": wall}}


@_axis(
    "focal lengths ±0.3 px, k1 ±0.0015, k2 ±0.0005, p1 and p2 ±0.0002, right eye against left",
    "[E] two eyes rectified one by one",
)
def two_lenses(rng: np.random.Generator, _usual: Settings) -> JSON:
    """What the right eye's lens has more than the left's."""
    wide = {"fx_px": 0.3, "fy_px": 0.3, "k1": 0.0015, "k2": 0.0005, "p1": 0.0002, "p2": 0.0002}
    drawn = {name: rng.uniform(-most, most) for name, most in wide.items()}
    return {"scene": {"camera": {"lens_difference": drawn}}}


@_axis(
    "disparity 0.05 to 0.3 px, rows 0.05 to 0.2 px rms, within 5 to 15 minutes",
    "[E] heat moves low-cost stereo cameras by a few parts in a thousand of a pixel a second",
)
def drift(rng: np.random.Generator, _usual: Settings) -> JSON:
    """How the rectification wanders as the camera warms."""
    drawn = {
        "disparity_px": rng.uniform(0.05, 0.3),
        "vertical_px": rng.uniform(0.05, 0.2),
        "time_constant_s": rng.uniform(300.0, 900.0),
    }
    return {"scene": {"camera": {"drift": drawn}}}


@_axis("−10 to 20 ms late, jitter 0.5 to 3 ms rms", "[E] a camera stamped by a host that is not real-time")
def stamps(rng: np.random.Generator, _usual: Settings) -> JSON:
    """What is wrong with the times that are told of pictures."""
    drawn = {"delay_ms": rng.uniform(-10.0, 20.0), "jitter_ms": rng.uniform(0.5, 3.0)}
    return {"scene": {"camera": {"stamps": drawn}}}


# ---- the markers


@_axis("±0.3 %", "[E] a copier's scale")
def tool_print(rng: np.random.Generator, _usual: Settings) -> JSON:
    """The printed size of the tool's marker."""
    return {"scene": {"tool_marker": {"print_scale_error": rng.uniform(-0.003, 0.003)}}}


@_axis(
    "places ±1 mm, turned by up to 0.5°, prints ±0.3 %, plates bent by up to 0.5 mm",
    "[E] a tape measure, a hand, a copier, a sheet of plastic",
)
def object_markers(rng: np.random.Generator, usual: Settings) -> JSON:
    """Where the object's markers are, and how large."""
    drawn = []
    for marker in usual.scene.object_of_interest.markers:
        off: JSON = {
            "misplaced_m": rng.uniform(-0.001, 0.001, 3).tolist(),
            "misplaced_deg": rng.uniform(-0.3, 0.3, 3).tolist(),
            "print_scale_error": rng.uniform(-0.003, 0.003),
            "bend_m": rng.uniform(-0.0005, 0.0005),
            "bend_direction_deg": rng.uniform(-90.0, 90.0),
        }
        drawn.append(marker.model_dump(mode="json") | off)
    return {"scene": {"object_of_interest": {"markers": drawn}}}
