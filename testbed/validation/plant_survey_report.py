"""`longreach validate plant-survey`: both arms over their workspace as tables and a plot."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from protocol.errors import ConfigurationError
from testbed.reporting.console import bars, out, table, write_json
from testbed.reporting.plots import AXIS_COLOURS
from testbed.validation.plant_survey import (
    ARMS,
    STATED_PLAY_MM,
    STATED_REACH_M,
    STATED_SAG_MM,
    SurveyedArm,
    SurveyRow,
    survey,
)


def run_survey(config_dir: Path, directory: Path, json_file: Path | None) -> list[SurveyRow]:
    """All rows; prints them with the stated figures, and writes the plot to ``directory/plant_survey.png``.

    Raises ConfigurationError when the plot cannot be written.
    """
    rows: list[SurveyRow] = []
    with bars() as shown, shown.step("surveying both arms") as bar:
        for k, arm in enumerate(ARMS):
            bar.update(k / len(ARMS), arm.name)
            rows += survey(config_dir, arm)
    for arm in ARMS:
        _print(arm, [row for row in rows if row.arm == arm.name])
    names = [f"{arm.name}, {arm.loads_kg[0]:g} to {arm.loads_kg[-1]:g} kg" for arm in ARMS]
    out.print(table("least / median / greatest over the workspace, mm", ("", *names), spreads(rows)))
    stated = beside_stated([row for row in rows if row.arm == ARMS[0].name])
    out.print(table("default arm beside stated figures", ("figure", "stated", "obtained"), stated))
    picture = directory / "plant_survey.png"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        plot(rows, picture)
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{picture}: {error.strerror}") from error
    out.print(f"plot written to {picture}", style="dim", highlight=False, soft_wrap=True)
    write_json(json_file, {"rows": rows, "stated": [list(line) for line in stated]})
    return rows


def _print(arm: SurveyedArm, rows: list[SurveyRow]) -> None:
    sags = [f"sag {mass:g} kg" for mass in arm.loads_kg]
    columns = (
        "lift, tilt °", "reach m", *sags, "play ±", "believed", "servo", "servo c.", "mode Hz", "damping %",
    )  # fmt: skip
    lines: list[tuple[object, ...]] = [
        (
            f"{row.lift_deg:g}, {row.tilt_deg:g}",
            f"{row.reach_m:.2f}",
            *(f"{value:.1f}" for value in (*row.sag_mm, row.play_mm, row.believed_mm, *row.servo_mm)),
            f"{row.lowest_hz:.2f}",
            f"{100.0 * row.damping:.1f}",
        )
        for row in sorted(rows, key=lambda row: row.reach_m)
    ]
    out.print(table(f"{arm.name}, tool level: millimetres at the tool", columns, lines))
    out.print(
        "sag under what hangs beyond the wrist; play of the slew; true tool off where encoders and nominal\n"
        "geometry place it; where u = K (q_d - q) rests by its reading, then with the deadband compensated",
        style="dim", highlight=False,
    )  # fmt: skip


def spreads(rows: list[SurveyRow]) -> list[tuple[str, ...]]:
    """For each figure, each arm's least, median and greatest value."""
    figures: dict[str, Callable[[SurveyRow], float]] = {
        "sag, lightest load": lambda row: row.sag_mm[0],
        "sag, heaviest load": lambda row: row.sag_mm[-1],
        "play of the slew, ±": lambda row: row.play_mm,
        "believed against true": lambda row: row.believed_mm,
        "rest of a proportional servo": lambda row: row.servo_mm[0],
        "the same, deadband compensated": lambda row: row.servo_mm[1],
        "lowest mode, Hz": lambda row: row.lowest_hz,
        "its damping, %": lambda row: 100.0 * row.damping,
    }
    lines = []
    for name, figure in figures.items():
        values = [[figure(row) for row in rows if row.arm == arm.name] for arm in ARMS]
        lines.append((name, *(f"{min(v):.3g} / {np.median(v):.3g} / {max(v):.3g}" for v in values)))
    return lines


def beside_stated(rows: list[SurveyRow]) -> list[tuple[str, str, str]]:
    """What is stated of this class of arm, and the range that the default arm's poses near there show."""
    near = [row for row in rows if abs(row.reach_m - STATED_REACH_M) < 0.15]
    lines = []
    for mass, stated in STATED_SAG_MM.items():
        sags = [row.sag_mm[ARMS[0].loads_kg.index(mass)] for row in near]
        lines.append((f"sag at {STATED_REACH_M:g} m under {mass:g} kg, mm", f"{stated:g}", _range(sags)))
    far = max(rows, key=lambda row: row.reach_m)
    lines.append(
        (f"slew play at the tip, {far.reach_m:.1f} m out, ± mm", f"{STATED_PLAY_MM:g}", f"{far.play_mm:.1f}")
    )
    return lines


def _range(values: list[float]) -> str:
    return f"{min(values):.1f} to {max(values):.1f}" if values else "no pose there"


def plot(rows: list[SurveyRow], picture: Path) -> None:
    """Write sag, lost position, servo rest and free vibration over reach as a PNG to ``picture``."""
    figure = Figure(figsize=(13.0, 6.4), layout="constrained")
    grid: Any = figure.subplots(len(ARMS), 4, squeeze=False)
    for arm, (sag, place, servo, ring) in zip(ARMS, grid, strict=True):
        mine = sorted((row for row in rows if row.arm == arm.name), key=lambda row: row.reach_m)
        reach = [row.reach_m for row in mine]
        for k, mass in enumerate(arm.loads_kg):
            sag.plot(reach, [row.sag_mm[k] for row in mine], "o", ms=3.5, label=f"{mass:g} kg")
        if arm is ARMS[0]:
            for mass, stated in STATED_SAG_MM.items():
                label = "stated: 30, 130, 230 kg" if mass == 30.0 else None
                sag.plot(STATED_REACH_M, stated, "kx", ms=8, label=label)
        believed, play = ([getattr(row, name) for row in mine] for name in ("believed_mm", "play_mm"))
        place.plot(reach, believed, "o", ms=3.5, color=AXIS_COLOURS[0], label="tool off where believed")
        place.plot(reach, play, "-", color=AXIS_COLOURS[1], label="play of the slew, ±")
        for k, law in enumerate(("u = K (q_d - q)", "deadband compensated")):
            rests = [row.servo_mm[k] for row in mine]
            servo.plot(reach, rests, "o", ms=3.5, color=AXIS_COLOURS[k], label=law)
        colours = ring.scatter(
            reach, [row.lowest_hz for row in mine], c=[100.0 * row.damping for row in mine], s=14
        )
        figure.colorbar(colours, ax=ring, label="damping, %")
        titles = ("sag behind the encoders", "believed against true, bare wrist",
                  "rest of a proportional servo", "lowest mode, valves shut")  # fmt: skip
        for axes, title, unit in zip(
            (sag, place, servo, ring), titles, ("mm", "mm", "mm", "Hz"), strict=True
        ):
            _finish(axes, f"{arm.name}: {title}", unit)
        for axes in (sag, place, servo):
            axes.legend(fontsize=7, loc="upper left", frameon=False)
    figure.savefig(picture, dpi=100)


def _finish(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("reach, m", fontsize=8)
    axes.set_ylabel(unit, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.set_ylim(0.0, 1.4 * float(np.max(axes.dataLim.y1)))
    axes.grid(alpha=0.3)
