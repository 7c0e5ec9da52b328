"""What bends, slips and rocks, by the names of its switches below ``plant.errors``."""

ENTRIES = (
    "encoder_eccentricity",
    "finer_bending",
    "torsion",
    "pin_compliance",
    "bearing_tilt",
    "loose_slew",
    "rocking_base",
    "vibration",
)
