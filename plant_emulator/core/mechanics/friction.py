"""LuGre seal friction (Canudas de Wit et al. 1995): stiction, Stribeck, pre-sliding, viscous drag."""

import math

from foundation.compiled import allocation_free


@allocation_free
def steady_level(velocity: float, coulomb: float, static: float, stribeck: float) -> float:
    """g(v) = F_c + (F_s − F_c) exp(−(v/v_s)²): the bristles' force in steady sliding."""
    ratio = velocity / stribeck
    return coulomb + (static - coulomb) * math.exp(-ratio * ratio)


@allocation_free
def bristle_rate(velocity: float, bristle: float, level: float, stiffness: float) -> float:
    """ż = v − σ0 |v| z / g(v), with g(v) given as ``level``; zero friction keeps the bristles at rest."""
    if level <= 0.0:
        return 0.0
    return velocity - stiffness * abs(velocity) * bristle / level


@allocation_free
def friction_force(
    velocity: float, bristle: float, rate: float, stiffness: float, micro_damping: float, viscous: float
) -> float:
    """F = σ0 z + σ1 ż + σ2 v (N, or N m for a rotary actuator)."""
    return stiffness * bristle + micro_damping * rate + viscous * velocity
