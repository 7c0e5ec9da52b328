"""`longreach experiment validation`: the plant against 31 families of cases with known answers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, NoSettings
from laboratory.validation.ledger import MISSING_ORACLE
from laboratory.validation.plant_balances import (
    convergence,
    encoders,
    energy_balance,
    pump_saturation,
    sudden_stop,
)
from laboratory.validation.plant_dynamics import accelerations, energy_drift, friction, locked_lift, ring_down
from laboratory.validation.plant_hydraulics import (
    blocked_piston,
    free_velocity,
    leakage_creep,
    orifice,
    spool,
)
from laboratory.validation.plant_play import eccentric_encoders, loose_slew, tilting_ring
from laboratory.validation.plant_rig import ValidationCase
from laboratory.validation.plant_statics import cantilevers, geometry, levers, static_forces, valve_shut_load
from laboratory.validation.plant_structure import rocking, several_hinges, twist, whole_chain
from laboratory.validation.plant_valves import (
    compensated_flow,
    hysteresis_and_slew,
    load_holding,
    overlaps,
)
from protocol.errors import ConfigurationError
from testbed.reporting.console import table

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


_RELATIONS = {"near": "", "at_most": "≤ ", "at_least": "≥ "}


class FamilyRow(NamedTuple):
    """A family that was run; ``left_out``: an oracle that it is compared with is not installed."""

    family: int
    cases: list[dict[str, Any]] | None
    left_out: bool
    failure: str
    cpu_s: float


Answered = Finished[NoSettings, FamilyRow]


def family_tasks(request: CampaignRequest, settings: NoSettings) -> list[Task]:
    """One task a family."""
    return [{"key": f"{number} {title}", "family": number} for number, (title, _) in FAMILIES.items()]


def one_family(config_dir: Path, task: Task) -> dict[str, Any]:
    """All cases of one family."""
    try:
        cases = [case._asdict() for case in FAMILIES[task["family"]][1](config_dir)]
    except ConfigurationError as error:
        if error.cause != MISSING_ORACLE:
            raise
        return {"family": task["family"], "cases": [], "left_out": True}
    return {"family": task["family"], "cases": cases, "left_out": False}


def cases_of(done: Answered) -> list[ValidationCase]:
    """The cases of all families that were run."""
    return [ValidationCase(**case) for row in done.rows for case in row.cases or ()]


def answers_table(done: Answered) -> list[Table]:
    """Every case."""
    headings = ("", "case", "unit", "expected", "obtained", "tolerance", "verdict", "source")
    cells = [
        (case.family, case.name, case.unit, f"{_RELATIONS[case.relation]}{case.expected:.6g}",
         f"{case.obtained:.6g}", f"{case.tolerance:.2g}", "passed" if case.passed else "FAILED", case.source)
        for case in cases_of(done)
    ]  # fmt: skip
    return [table("plant against known answers", headings, cells)]


def answers_verdict(done: Answered) -> list[Check]:
    """Every case of every family passed; a family whose oracle is not installed did not."""
    cases = cases_of(done)
    passed = sum(case.passed for case in cases)
    absent = [str(row.family) for row in done.rows if row.left_out]
    failed = [str(row.family) for row in done.rows if row.failure]
    return [
        Check("cases that passed", f"{passed} of {len(cases)}", "all", 0 < passed == len(cases)),
        Check("families that failed", ", ".join(failed) or "none", "none", not failed),
        Check(
            "families left out, MuJoCo or Pinocchio not installed (make setup-dev)",
            ", ".join(absent) or "none",
            "none",
            not absent,
        ),
    ]


KNOWN_ANSWERS = Experiment(
    name="known-answers",
    title="The plant against cases with known answers.",
    settings=NoSettings,
    row=FamilyRow,
    tasks=family_tasks,
    run=one_family,
    table=answers_table,
    verdict=answers_verdict,
    world="the plant alone",
    eyes="none",
    workers=0,
)
