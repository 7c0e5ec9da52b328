"""What makes rigid-body positioning wrong over the workspace: sag, play, static error, vibration."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from controller.config import ArmConfig
from controller.core.denavit_hartenberg import dh_table, tool_pose
from plant_emulator.core.plant import Plant
from plant_emulator.plant_config import PlantConfig
from protocol.configuration import load
from protocol.process_image import COUNTS_PER_TURN

Array = NDArray[np.float64]

LIFTS_DEG = tuple(range(0, 91, 15))
TILTS_DEG = tuple(range(-130, -29, 20))
LOADS_KG = (70.0, 130.0, 230.0)  # beyond the wrist; the bare wrist and tool are 70 kg
STATED_SAG_MM = {30.0: 13.0, 130.0: 28.0, 230.0: 43.0}  # at 4.1 m, of an earlier model of this arm


class SurveyRow(NamedTuple):
    """One pose, tool level: what the encoders do not tell, and how the arm vibrates with its valves shut."""

    lift_deg: float
    tilt_deg: float
    reach_m: float
    sag_mm: tuple[float, float, float]
    play_mm: float
    static_error_mm: float
    lowest_hz: float
    lowest_damping: float


def survey(
    config_dir: Path, lifts_deg: Sequence[int] = LIFTS_DEG, tilts_deg: Sequence[int] = TILTS_DEG
) -> list[SurveyRow]:
    """One row for every pose of the grid in which wrist 2 can hold the tool level."""
    rows = []
    for lift in lifts_deg:
        for tilt in tilts_deg:
            level = lift + tilt
            if abs(level) <= 85.0:
                rows.append(_row(config_dir, float(lift), float(tilt), float(level)))
    return rows


def _row(config_dir: Path, lift: float, tilt: float, level: float) -> SurveyRow:
    pose: dict[str, object] = {"start_pose_deg": [0.0, lift, tilt, 0.0, level, 0.0]}
    sags = []
    for mass in LOADS_KG:
        bent, stiff = (
            _plant(
                config_dir,
                {**pose, "payload": {"mass_kg": mass - 70.0}, "flexibility": {"enabled": flexible}},
            )
            for flexible in (True, False)
        )
        sags.append(float(np.linalg.norm((bent.truth().X_BT - stiff.truth().X_BT)[:3, 3])) * 1e3)
    plant = _plant(config_dir, pose)
    truth, angles = plant.truth(), np.array(plant.read().encoder_counts) * (2.0 * np.pi / COUNTS_PER_TURN)
    believed = tool_pose(dh_table(load(ArmConfig, config_dir / "arm.yaml").dh), angles)[:3, 3]
    reach = float(np.hypot(truth.X_BT[0, 3], truth.X_BT[1, 3]))
    spectrum = plant.vibrations()
    lowest = min((mode for mode in spectrum if mode.imag > 0.1), key=abs)
    return SurveyRow(
        lift_deg=lift,
        tilt_deg=tilt,
        reach_m=reach,
        sag_mm=(sags[0], sags[1], sags[2]),
        play_mm=2.0 * plant.config.errors.backlash.half_width_mrad[0] * reach,
        static_error_mm=float(np.linalg.norm(truth.X_BT[:3, 3] - believed)) * 1e3,
        lowest_hz=abs(lowest) / (2.0 * np.pi),
        lowest_damping=-lowest.real / abs(lowest),
    )


def _plant(config_dir: Path, changes: dict[str, object]) -> Plant:
    return Plant(load(PlantConfig, config_dir / "plant.yaml", changes), seed=1)


def plot_survey(rows: list[SurveyRow], picture: Path) -> None:
    """Write sag, static error, play and lowest frequency over reach as a PNG to ``picture``."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    (sag, error), (play, frequency) = figure.subplots(2, 2)
    reach = [row.reach_m for row in rows]
    for k, mass in enumerate(LOADS_KG):
        sag.plot(reach, [row.sag_mm[k] for row in rows], "o", label=f"{mass:g} kg")
    for mass, stated in STATED_SAG_MM.items():
        sag.plot(4.1, stated, "kx", label="earlier model, 30/130/230 kg" if mass == 30.0 else None)
    sag.legend(fontsize=8, loc="upper left", ncols=2)
    error.plot(reach, [row.static_error_mm for row in rows], "o")
    play.plot(reach, [row.play_mm for row in rows], "o")
    sag.set_ylim(0.0, 75.0)
    colours = frequency.scatter(reach, [row.lowest_hz for row in rows], c=[row.lift_deg for row in rows])
    figure.colorbar(colours, ax=frequency, label="lift, °")
    titles = (
        "sag behind the encoders, mm",
        "believed against true tool, mm",
        "slew play at the tool, mm",
        "lowest mode, Hz",
    )
    for axes, title in zip((sag, error, play, frequency), titles, strict=True):
        axes.set_title(title)
        axes.set_xlabel("reach, m")
        axes.grid(alpha=0.3)
    figure.savefig(picture, dpi=120)
