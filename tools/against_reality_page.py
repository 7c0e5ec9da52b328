"""The measured table of docs/against_reality.md; ``python -m tools.against_reality_page`` writes it."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from foundation.configuration import load, parse_overrides
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.plant import Plant
from protocol.process_image import CONTROL_ENABLE, ValveImage
from tools.protocol_page import filled
from tools.tables import table

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "against_reality.md"
_MOVED_RAD = 2e-3
_TICK_NS = 2_000_000
_STEP_S = 1.5
_AXES = ("slew", "lift", "tilt")


Spools = tuple[float, float, float, float, float, float]


class RealityFigure(NamedTuple):
    """A figure of real machines with its source, the emulator's, and the verdict."""

    what: str
    reality: str
    source: str
    ours: str
    verdict: str


class StepAnswer(NamedTuple):
    """A step of one valve: when its joint had moved by 2 mrad (s), its speed after that (rad/s)."""

    delay_s: float
    speed: float


def plant(*assignments: str) -> Plant:
    """The default arm with ``assignments``, at rest for half a second."""
    changes = parse_overrides(assignments).get("plant")
    arm = Plant(load(PlantConfig, ROOT / "configs" / "plant.yaml", changes), 1)
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
    arm = plant("plant.valve_set=mobile")
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


def of_motion() -> Iterator[RealityFigure]:
    """How joints answer to a step of their mobile valves."""
    mobile = "plant.valve_set=mobile"
    pairs = [(stepped(k, 0.4, mobile), stepped(k, -0.4, mobile)) for k in range(3)]
    delays = [1e3 * step.delay_s for pair in pairs for step in pair]
    uneven = [100.0 * abs(a.speed - b.speed) / (0.5 * (a.speed + b.speed)) for a, b in pairs]
    excavator = (
        "measured from the step logs in mitchallain/BeagleBone-excavator (hydraulic, radio-controlled size)"
    )
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


def of_parts() -> Iterator[RealityFigure]:
    """Spools, base and camera."""
    spools = load(PlantConfig, ROOT / "configs" / "plant.yaml").valve_sets["mobile"]
    edges = [overlap for name in JOINT_NAMES for overlap in spools.of(name, 40.0).deadband]
    yield RealityFigure(
        "overlap of a mobile spool", "±0.8 of 7 mm: 11 %", "Danfoss PVE series 4 manual, p. 17",
        f"{100 * min(edges):.1f} to {100 * max(edges):.1f} %", "set by configuration, around it",
    )  # fmt: skip
    yield RealityFigure(
        "neutral to full stroke", "120 to 230 ms", "Danfoss PVG 32, recalled, not verified",
        f"{1e3 * stroke_s():.0f} ms to 95 %", _inside(1e3 * stroke_s(), 120.0, 230.0),
    )  # fmt: skip
    rocking = rocking_deg_s()
    yield RealityFigure(
        "rate of a carrier under its arm", "0.3 to 3.7 °/s rms",
        "eetmie/Isaac-hydraulic-actuator, logs of a 1:14 excavator (Apache 2.0)",
        f"{rocking:.2f} °/s rms, slew to and fro", _inside(rocking, 0.3, 3.7),
    )  # fmt: skip
    camera = load(SceneConfig, ROOT / "configs" / "scene.yaml").camera
    fb = camera.lens.fx_px * camera.baseline_m
    yield RealityFigure(
        "depth told of a wall at 12 m, disparity 3.5 px off",
        "25 m, f·b 80.4 px·m",
        "stereolabs/zed-sdk issue 44",
        f"{_told_m(80.4):.0f} m by the same law; with our f·b of {fb:.1f} {_told_m(fb):.0f} m",
        "inside; `real` worlds draw ±3.5 px",
    )  # fmt: skip


def _told_m(fb: float) -> float:
    """What a camera with ``fb`` (px m) that is off by 3.5 px of disparity says of 12 m."""
    return fb / (fb / 12.0 - 3.5)


def _each(values: list[float], low: float, high: float) -> str:
    return f"{sum(low <= value <= high for value in values)} of {len(values)} inside"


def _inside(value: float, low: float, high: float) -> str:
    return "inside" if low <= value <= high else "outside"


def rendered(text: str) -> str:
    """``text`` with the table measured anew."""
    head = "what | real machines | source | the emulator | verdict"
    return filled(text, {"against reality": table(head, [*of_motion(), *of_parts()])})


if __name__ == "__main__":
    PAGE.write_text(rendered(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
