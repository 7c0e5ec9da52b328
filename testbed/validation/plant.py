"""The plant's validation: 31 families of cases with known answers, run as one table."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from protocol.errors import ConfigurationError
from testbed.validation.case import ValidationCase
from testbed.validation.oracles import MISSING_ORACLE
from testbed.validation.plant_balances import energy_balance, pump_saturation, sudden_stop
from testbed.validation.plant_dynamics import accelerations, energy_drift, locked_lift, ring_down
from testbed.validation.plant_friction import friction
from testbed.validation.plant_hydraulics import blocked_piston, free_velocity, leakage_creep, orifice, spool
from testbed.validation.plant_play import eccentric_encoders, loose_slew, tilting_ring
from testbed.validation.plant_signals import convergence, encoders
from testbed.validation.plant_statics import cantilevers, geometry, levers, static_forces, valve_shut_load
from testbed.validation.plant_structure import rocking, several_hinges, twist, whole_chain
from testbed.validation.plant_valves import (
    compensated_flow,
    hysteresis_and_slew,
    load_holding,
    overlaps,
)

Family = Callable[[Path], list[ValidationCase]]

FAMILIES: dict[int, tuple[str, Family]] = {
    1: ("geometry", geometry),
    2: ("lever arms", levers),
    3: ("static cylinder forces", static_forces),
    4: ("accelerations against two oracles", accelerations),
    5: ("energy drift", energy_drift),
    6: ("orifice", orifice),
    7: ("spool", spool),
    8: ("free velocities", free_velocity),
    9: ("blocked piston", blocked_piston),
    10: ("locked lift on its oil", locked_lift),
    11: ("more load on a shut valve", valve_shut_load),
    12: ("cantilevers", cantilevers),
    13: ("ring-down", ring_down),
    14: ("friction", friction),
    15: ("leakage creep", leakage_creep),
    16: ("sudden stop", sudden_stop),
    17: ("energy balance", energy_balance),
    18: ("pump saturation", pump_saturation),
    19: ("encoders", encoders),
    20: ("convergence and replay", convergence),
    21: ("beams of several hinges", several_hinges),
    22: ("twist of links and pins", twist),
    23: ("rocking base", rocking),
    24: ("the whole chain", whole_chain),
    25: ("loose slew", loose_slew),
    26: ("tilting ring", tilting_ring),
    27: ("eccentric encoders", eccentric_encoders),
    28: ("valve overlap and flow curve", overlaps),
    29: ("hysteresis and slew", hysteresis_and_slew),
    30: ("compensated flow", compensated_flow),
    31: ("load-holding valves", load_holding),
}


class FamilyRun(NamedTuple):
    """A family that was run; ``cases`` is None where an oracle that it is compared with is not installed."""

    number: int
    title: str
    cases: list[ValidationCase] | None


def validation_steps(config_dir: Path) -> Iterator[FamilyRun]:
    """Every family, computed as it is asked for (for a progress bar)."""
    for number, (title, family) in FAMILIES.items():
        try:
            yield FamilyRun(number, title, family(config_dir))
        except ConfigurationError as error:
            if error.cause != MISSING_ORACLE:
                raise
            yield FamilyRun(number, title, None)
