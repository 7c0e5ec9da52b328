"""Oil in a closed volume: effective bulk modulus with entrained air, and what keeps pressure in bounds.

Pressures are absolute and never clipped: oil that leaves a chamber must have been in it. What a real circuit
does at the ends of the range is modelled as flow instead (relief, anti-cavitation), and entrained air softens
the oil as the pressure falls, so that pressure approaches zero without crossing it.
"""

from foundation.compiled import allocation_free

ATMOSPHERE = 101_325.0  # Pa
FLOOR = 1_000.0  # Pa: below it the air term is held constant, so that the modulus stays above zero


@allocation_free
def bulk_modulus(
    pressure: float, volume: float, oil: float, wall: float, air: float, exponent: float
) -> float:
    """Effective bulk modulus (Pa) of a chamber: 1/β = 1/β_oil + C_wall/V + α (p0/p)^(1/n)/(n p).

    ``wall`` is the compliance of barrel and hose (m³/Pa), ``air`` the entrained volume fraction at
    atmospheric pressure. Each term is a relative volume per pascal, hence mass is conserved whatever the
    pressure does.
    """
    p = max(pressure, FLOOR)
    softness = 1.0 / oil + wall / volume
    if air > 0.0:
        softness += air * (ATMOSPHERE / p) ** (1.0 / exponent) / (exponent * p)
    return 1.0 / softness


@allocation_free
def relief_flow(pressure: float, setting: float, gain: float) -> float:
    """Flow (m³/s) that a relief valve lets out: ``gain`` (m³/s/Pa) times the excess over ``setting``."""
    return gain * max(pressure - setting, 0.0)
