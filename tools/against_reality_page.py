"""The measured table of docs/against_reality.md; ``python -m tools.against_reality_page`` writes it."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load, parse_overrides
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core import layout as col
from plant_emulator.core.mechanics.geometry import actuator_position
from plant_emulator.core.plant import Plant
from protocol.process_image import CONTROL_ENABLE, ValveImage
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.scenarios.scenario import load_settings
from tools.protocol_page import filled
from tools.tables import table

CONFIGS = Path(__file__).parents[1] / "configs"
MOBILE = "plant.valve_set=mobile"
RADIUS_M = 0.05
SPEED_M_S = 0.02
_MOVED_RAD = 2e-3
_TICK_NS = 2_000_000
_STEP_S = 1.5
_LIFT, _TILT = 1, 2
_SEND_S = 0.02
_BEGIN_S = 4.0  # of the circle, during which the arm starts from rest

Array = NDArray[np.float64]
Spools = tuple[float, float, float, float, float, float]


class StepAnswer(NamedTuple):
    """A step of one valve: when its joint had moved by 2 mrad (s), its speed after that (rad/s)."""

    delay_s: float
    speed: float


def plant(*assignments: str) -> Plant:
    """The default arm with ``assignments``, at rest for half a second."""
    changes = parse_overrides(assignments).get("plant")
    arm = Plant(load(PlantConfig, CONFIGS / "plant.yaml", changes), 1)
    arm.advance(500_000_000)
    return arm


def driven(arm: Plant, spools: Spools, seconds: float) -> Iterator[Plant]:
    """The arm every 2 ms under an open-loop command."""
    for cycle in range(1, round(seconds * 1e9 / _TICK_NS) + 1):
        arm.write(ValveImage(cycle, CONTROL_ENABLE, spools))
        arm.advance(_TICK_NS)
        yield arm


def stepped(axis: int, spool: float, *assignments: str) -> StepAnswer:
    """The answer of one joint to a step of its valve."""
    arm = plant(*assignments)
    slew, lift, tilt = (spool if k == axis else 0.0 for k in range(3))
    begin = arm.truth().q[axis]
    way = np.array(
        [abs(now.truth().q[axis] - begin) for now in driven(arm, (slew, lift, tilt, 0.0, 0.0, 0.0), _STEP_S)]
    )
    moved = int(np.argmax(way > _MOVED_RAD))
    times = 1e-9 * _TICK_NS * np.arange(1, len(way) + 1)
    late = times > _STEP_S - 0.5
    return StepAnswer(float(times[moved]), float(np.polyfit(times[late], way[late], 1)[0]))


def stroke_s() -> float:
    """How long the lift's spool takes from the centre to 95 % of its stroke, mobile valves."""
    arm = plant(MOBILE)
    for count, now in enumerate(driven(arm, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0), 0.6), 1):
        if abs(now.truth().spools[1]) > 0.95:
            return 1e-9 * _TICK_NS * count
    return float("nan")


def rocking_deg_s() -> float:
    """Rate of the base while the slew starts, turns and stops, rms over 4 s, degrees a second."""
    arm = plant("plant.errors.rocking_base.enabled=true", "plant.errors.vibration.enabled=true")
    turned = []
    for spool in (0.05, 0.0, -0.05, 0.0):
        turned += [now.truth().X_WB[:3, :3] for now in driven(arm, (spool, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0)]
    steps = [now @ before.T for before, now in pairwise(turned)]
    small = np.array([[step[2, 1], step[0, 2], step[1, 0]] for step in steps])
    return float(np.degrees(np.sqrt(np.mean((small**2).sum(axis=1)))) / (1e-9 * _TICK_NS))


def drift_mm(minutes: float, *assignments: str) -> Array:
    """How far (2,) the rods of lift and tilt have gone in with the valves shut and 100 kg at the tool."""
    arm = plant("plant.payload.mass_kg=100", *assignments)
    arm.advance(5_000_000_000)
    rods = [_rods_m(arm)]
    for _ in range(round(60.0 * minutes)):
        arm.advance(1_000_000_000)
    rods.append(_rods_m(arm))
    return np.asarray(1e3 * np.abs(rods[1] - rods[0]))


def _rods_m(arm: Plant) -> Array:
    """Piston positions (2,) of lift and tilt."""
    q, table = arm.truth().q, arm.model.actuators
    return np.array([actuator_position(q[i], *table[i, : col.A_LENGTH0 + 1]) for i in (_LIFT, _TILT)])


def hysteresis_percent() -> float:
    """Width of the loop between command and spool of the lift's mobile valve, in percent of the stroke.

    The command goes up and down slowly between half and full stroke; the loop is read in its middle.
    """
    arm = plant(MOBILE)
    ramp = np.linspace(0.5, 1.0, 400)
    spools = {}
    for name, told in (("up", ramp), ("down", ramp[::-1])):
        loop = []
        for command in told:
            *_, now = driven(arm, (0.0, float(command), 0.0, 0.0, 0.0, 0.0), 0.02)
            loop.append(float(now.truth().spools[_LIFT]))
        spools[name] = loop
    middle = len(ramp) // 2
    return 100.0 * (spools["down"][middle] - spools["up"][middle])


def circled_mm(*assignments: str) -> Array:
    """Radial errors (n,) of a streamed upright circle of 50 mm radius at 20 mm/s, by the encoders."""
    rig = LockstepRig(
        load_settings(CONFIGS, parse_overrides(assignments)), 1, RunLog(),
        lambda world: simulated_sight(world, load_eye_model(CONFIGS), 1),
    )  # fmt: skip
    rig.command("enable")
    return np.asarray(1e3 * run(_circle(rig)))


async def _circle(rig: LockstepRig) -> Array:
    """Radial errors (m) over one lap, after the start."""
    arm, clock = rig.application.arm, rig.world.clock
    X = (await arm.view()).X_BT.copy()
    centre = X[:3, 3] - [RADIUS_M, 0.0, 0.0]
    turning = SPEED_M_S / RADIUS_M
    errors = []
    async with arm.streaming() as stream:
        for now in np.arange(0.0, _BEGIN_S + 2.0 * np.pi / turning, _SEND_S):
            out = np.array([np.cos(turning * now), 0.0, np.sin(turning * now)])
            along = np.array([-out[2], 0.0, out[0]])
            X[:3, 3] = centre + RADIUS_M * out
            await stream.send(X, twist_ref=np.concatenate([SPEED_M_S * along, np.zeros(3)]))
            await clock.until(lambda: False, _SEND_S)
            off = (await stream.view()).X_BT[:3, 3] - centre
            if now >= _BEGIN_S:
                errors.append(np.hypot(off[0], off[2]) - RADIUS_M)
    return np.array(errors)


ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "against_reality.md"
_AXES = ("slew", "lift", "tilt")


class RealityFigure(NamedTuple):
    """A figure of real machines with its source, the emulator's, and the verdict."""

    what: str
    reality: str
    source: str
    ours: str
    verdict: str


def of_motion() -> Iterator[RealityFigure]:
    """How joints answer to a step of their mobile valves."""
    pairs = [(stepped(k, 0.4, MOBILE), stepped(k, -0.4, MOBILE)) for k in range(3)]
    delays = [1e3 * step.delay_s for pair in pairs for step in pair]
    uneven = [100.0 * abs(a.speed - b.speed) / (0.5 * (a.speed + b.speed)) for a, b in pairs]
    excavator = "step logs in mitchallain/BeagleBone-excavator (radio-controlled size)"
    yield RealityFigure(
        "start delay of an axis, mobile valves", "95 to 221 ms, median 156", excavator,
        f"{min(delays):.0f} to {max(delays):.0f} ms, median {np.median(delays):.0f} (2 mrad, spool 40 %)",
        _each(delays, 95.0, 221.0),
    )  # fmt: skip
    told = ", ".join(f"{name} {value:.0f} %" for name, value in zip(_AXES, uneven, strict=True))
    yield RealityFigure(
        "speed in one direction against the other", "10 to 25 %", excavator, told,
        _each(uneven, 10.0, 25.0),
    )  # fmt: skip


def of_rest() -> Iterator[RealityFigure]:
    """What goes on while nobody asks for motion."""
    new, limit = np.array([6.0, 12.0]), np.array([24.0, 30.0])
    for name, changes in (("servo", ()), ("mobile", (MOBILE,))):
        drift = drift_mm(3.0, *changes)
        yield RealityFigure(
            f"rods of lift and tilt sinking in 3 minutes, valves shut, {name} valves",
            "new 6 and 12 mm, limit 24 and 30 mm",
            "drift check, Caterpillar 308C service pages",
            f"{drift[0]:.1f} and {drift[1]:.1f} mm with 100 kg",
            "as new" if (drift <= new).all() else "within service" if (drift <= limit).all() else "outside",
        )


def of_tracking() -> Iterator[RealityFigure]:
    """A streamed circle, with the control that ships."""
    errors = np.abs(circled_mm())
    yield RealityFigure(
        "radial error of a circle at 20 mm/s, radius 50 mm", "2.3 mm mean with PID",
        "eetmie/Isaac-hydraulic-actuator, a 1:14 excavator",
        f"{errors.mean():.1f} mm mean, {errors.max():.0f} mm at most, by the encoders, servo valves",
        _inside(float(errors.mean()), 0.0, 2.3),
    )  # fmt: skip


def of_parts() -> Iterator[RealityFigure]:
    """Spools, base and camera."""
    spools = load(PlantConfig, ROOT / "configs" / "plant.yaml").valve_sets["mobile"]
    edges = [overlap for name in JOINT_NAMES for overlap in spools.of(name, 40.0).deadband]
    yield RealityFigure(
        "overlap of a mobile spool", "direction indicator at ±0.8 of 7 mm, 11 %",
        "Danfoss PVE series 4 manual, p. 17",
        f"{100 * min(edges):.1f} to {100 * max(edges):.1f} %", "set by configuration, up to it",
    )  # fmt: skip
    yield RealityFigure(
        "neutral to full stroke", "120 to 230 ms", "Danfoss PVG 32, recalled, not verified",
        f"{1e3 * stroke_s():.0f} ms to 95 %", _inside(1e3 * stroke_s(), 120.0, 230.0),
    )  # fmt: skip
    loop = hysteresis_percent()
    yield RealityFigure(
        "loop between command and spool", "PVES 0 to 2 %, PVEH 4 %, PVEM 20 % of the stroke",
        "Danfoss PVE classes, recalled, not verified", f"{loop:.1f} %", _inside(loop, 0.0, 20.0),
    )  # fmt: skip
    rocking = rocking_deg_s()
    yield RealityFigure(
        "rate of a carrier under its arm", "0.3 to 3.7 °/s rms",
        "eetmie/Isaac-hydraulic-actuator, a 1:14 excavator",
        f"{rocking:.2f} °/s rms, slew to and fro", _inside(rocking, 0.3, 3.7),
    )  # fmt: skip
    camera = load(SceneConfig, ROOT / "configs" / "scene.yaml").camera
    fb = camera.lens.fx_px * camera.baseline_m
    yield RealityFigure(
        "depth measured of a wall at 25 m, disparity 3.5 px off",
        "12 m, f·b 80.4 px·m",
        "stereolabs/zed-sdk issue 44",
        f"{_told_m(80.4):.0f} m by the same law; with our f·b of {fb:.1f} {_told_m(fb):.0f} m",
        "inside; `real` worlds draw ±3.5 px",
    )  # fmt: skip


def _told_m(fb: float) -> float:
    """What a camera with ``fb`` (px m) that is off by 3.5 px of disparity says of 25 m."""
    return fb / (fb / 25.0 + 3.5)


def _each(values: list[float], low: float, high: float) -> str:
    return f"{sum(low <= value <= high for value in values)} of {len(values)} inside"


def _inside(value: float, low: float, high: float) -> str:
    return "inside" if low <= value <= high else "outside"


def rendered(text: str) -> str:
    """``text`` with the table measured anew."""
    head = "what | real machines | source | the emulator | verdict"
    rows = [*of_motion(), *of_tracking(), *of_rest(), *of_parts()]
    return filled(text, {"against reality": table(head, rows)})


if __name__ == "__main__":
    PAGE.write_text(rendered(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
