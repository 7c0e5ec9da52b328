"""Family 14: LuGre friction in steady sliding, at break-away and before sliding."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import columns as col
from plant_emulator.core.mechanics.friction import bristle_rate, friction_force, steady_level
from testbed.validation.case import ValidationCase
from testbed.validation.plant_rig import Stand, default_config

Array = NDArray[np.float64]


class Seal:
    """The lift's seal, dragged by the plant's own equations."""

    def __init__(self, row: Array) -> None:
        self.coulomb, self.static, self.stribeck, self.stiffness, self.damping, self.viscous = (
            float(value) for value in row[col.A_COULOMB : col.A_VISCOUS + 1]
        )
        self.bristle = 0.0

    def drag(self, velocity: float, h: float) -> float:
        """The friction force after ``h`` seconds at ``velocity``; bristles by the midpoint rule."""
        level = steady_level(velocity, self.coulomb, self.static, self.stribeck)
        middle = self.bristle + 0.5 * h * bristle_rate(velocity, self.bristle, level, self.stiffness)
        self.bristle += h * bristle_rate(velocity, middle, level, self.stiffness)
        rate = bristle_rate(velocity, self.bristle, level, self.stiffness)
        return float(friction_force(velocity, self.bristle, rate, self.stiffness, self.damping, self.viscous))


def friction(config_dir: Path) -> list[ValidationCase]:
    """Family 14: the steady curve, the largest force before sliding, the slope of the first micrometres."""
    row = Stand(default_config(config_dir)).model.actuators[1]
    worst = 0.0
    for velocity in (-0.3, -0.05, -0.01, -0.002, 0.0005, 0.005, 0.02, 0.1, 0.5):
        seal, h = Seal(row), min(1e-3, 2e-5 / abs(velocity))
        for _ in range(int(6e-3 / abs(velocity) / h)):
            force = seal.drag(velocity, h)
        curve = np.sign(velocity) * (
            seal.coulomb + (seal.static - seal.coulomb) * np.exp(-((velocity / seal.stribeck) ** 2))
        )
        worst = max(worst, abs(force / (curve + seal.viscous * velocity) - 1.0))
    return [
        ValidationCase(
            14,
            "steady curve, nine velocities",
            "",
            0.0,
            float(worst),
            1e-3,
            "F_c + (F_s − F_c) e^−(v/v_s)² + σ2 v",
        ),
        ValidationCase(14, "break-away force", "kN", 5.0, _break_away(row) / 1e3, 0.05, "F_s"),
        ValidationCase(14, "pre-sliding slope", "N/µm", 8.0, _first_slope(row), 0.08, "σ0"),
    ]


def _break_away(row: Array) -> float:
    """The largest bristle force (N) before 500 kg slide off, pulled by a force that rises by 100 N/s."""
    seal, mass, h, velocity, first = Seal(row), 500.0, 2e-5, 0.0, 4.5e3
    seal.bristle, most = first / seal.stiffness, 0.0
    for step in range(round(7.0 / h)):
        velocity += h * (first + 100.0 * step * h - seal.drag(velocity, h)) / mass
        most = max(most, seal.stiffness * seal.bristle)
        if velocity > 2.0 * seal.stribeck:
            return most
    return float("nan")


def _first_slope(row: Array) -> float:
    """Force over displacement (N/µm) of the first 10 µm, pulled slowly."""
    seal, h, velocity = Seal(row), 1e-3, 1e-5
    forces = [seal.drag(velocity, h) for _ in range(1000)]
    return (forces[-1] - forces[0]) / (999 * h * velocity * 1e6)
