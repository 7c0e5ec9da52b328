"""The measured table of docs/against_reality.md; ``python -m tools.against_reality_page`` writes it."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig
from plant_emulator.config.valves import JOINT_NAMES
from tools.protocol_page import filled
from tools.reality_measurements import (
    MOBILE,
    circled_mm,
    drift_mm,
    hysteresis_percent,
    rocking_deg_s,
    stepped,
    stroke_s,
)
from tools.tables import table

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


def of_rest() -> Iterator[RealityFigure]:
    """What goes on while nobody asks for motion."""
    new, limit = np.array([6.0, 12.0]), np.array([24.0, 30.0])
    for name, changes in (("servo", ()), ("mobile", (MOBILE,))):
        drift = drift_mm(3.0, *changes)
        yield RealityFigure(
            f"rods of lift and tilt going in in 3 minutes, valves shut, {name} valves",
            "new 6 and 12 mm at most, service limit 24 and 30 mm",
            "drift check of loaded boom and stick cylinders, Caterpillar 308C service pages",
            f"{drift[0]:.1f} and {drift[1]:.1f} mm with 100 kg",
            "as new" if (drift <= new).all() else "within service" if (drift <= limit).all() else "outside",
        )


def of_tracking() -> Iterator[RealityFigure]:
    """A streamed circle, with the control that ships."""
    errors = np.abs(circled_mm())
    yield RealityFigure(
        "radial error of a circle at 20 mm/s, radius 50 mm", "2.3 mm mean with PID",
        "eetmie/Isaac-hydraulic-actuator, a 1:14 excavator (Apache 2.0)",
        f"{errors.mean():.1f} mm mean, {errors.max():.0f} mm at most, by the encoders, servo valves",
        _inside(float(errors.mean()), 0.0, 2.3),
    )  # fmt: skip


def of_parts() -> Iterator[RealityFigure]:
    """Spools, base and camera."""
    spools = load(PlantConfig, ROOT / "configs" / "plant.yaml").valve_sets["mobile"]
    edges = [overlap for name in JOINT_NAMES for overlap in spools.of(name, 40.0).deadband]
    yield RealityFigure(
        "overlap of a mobile spool", "out of neutral by ±0.8 of 7 mm, 11 %, for its own direction indicator",
        "Danfoss PVE series 4 manual, p. 17; no figure of the overlap itself was found",
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
        "eetmie/Isaac-hydraulic-actuator, logs of a 1:14 excavator (Apache 2.0)",
        f"{rocking:.2f} °/s rms, slew to and fro", _inside(rocking, 0.3, 3.7),
    )  # fmt: skip
    camera = load(SceneConfig, ROOT / "configs" / "scene.yaml").camera
    fb = camera.lens.fx_px * camera.baseline_m
    yield RealityFigure(
        "depth told of a wall at 25 m, disparity 3.5 px off",
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
