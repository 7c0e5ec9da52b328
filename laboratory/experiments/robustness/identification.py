"""`longreach experiment identification`: plants drawn from the priors, recorded, and identified again.

Each run draws every parameter that is fitted, lets that plant move through the usual excitation, and fits the
plant file to the recording. Asked is whether the truth lies where the fit says, by its own covariance, and
whether motion that was not fitted is predicted.
"""

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from foundation.configuration import load
from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, at_most, inside, seeds
from plant_emulator.config.plant import PlantConfig
from testbed.identification.excitation import FINE_STEP_MS, held_out, record, standard, widest_overlap
from testbed.identification.findings import excess, findings
from testbed.identification.fit import Identified, identify
from testbed.identification.parameters import Parameter, base_of, changed, parameters_of
from testbed.identification.recording import Array, Machine, check_recording
from testbed.identification.validation import check_believable, check_noise, validate
from testbed.reporting.console import Columns, listed

FILE_KG = 60.0  # [D] the plant file's payload, around which the true one is drawn
JOINTS = (0, 1, 2)
_WRONG = 2.0
"""NEES above which a fit is wrong: by chance one of 3000 plants of 36 parameters is above it."""
_REACH = 2.0  # spreads of its prior: how far a parameter is drawn at most
_MACHINE = Machine("drawn", "0" * 16, "servo")


class DrawSettings(NamedTuple):
    """Which valves."""

    valve_set: Annotated[str, typer.Option(help="Which of plant.yaml's valve_sets.")] = "servo"


class IdentifiedRow(NamedTuple):
    """One plant: NEES over its parameters, the parameter that is furthest off in σ, and the prediction.

    ``fit`` and ``before``: the least share of a joint's held-out motion that the fitted plant and the plant
    file predict. ``chi2``: of what is left, over the noise. ``promised``: χ² that the fit had still to
    fall by, as its last slopes tell. ``white``: the least share of a signal's autocorrelations that are as of
    noise.
    """

    seed: int
    parameters: int
    identified: int
    nees: float
    outside: int
    worst_sigma: float
    worst: str
    chi2: float
    fit: float
    before: float
    promised: float
    white: float
    failure: str = ""
    cpu_s: float = float("nan")


Drawn = Finished[DrawSettings, IdentifiedRow]


def drawn_theta(parameters: list[Parameter], rng: np.random.Generator) -> Array:
    """A true plant (p,): each parameter from its prior, cut off; delays on the steps of the plant."""
    theta = np.array([p.spread * float(np.clip(rng.standard_normal(), -_REACH, _REACH)) for p in parameters])
    for k, parameter in enumerate(parameters):
        if parameter.name == "payload":
            theta[k] = rng.uniform(5.0 - FILE_KG, 60.0)
        if parameter.name == "valve delay":
            theta[k] = round(theta[k] / FINE_STEP_MS) * FINE_STEP_MS
    return theta


def identified_plant(config_dir: Path, task: dict[str, Any]) -> IdentifiedRow:
    """The plant of ``task``'s ``seed``, recorded and identified in this process.

    Raises ConfigurationError where `longreach identify` refuses the plant, with its cause.
    """
    overrides = {"payload": {"mass_kg": FILE_KG}, "valve_set": task["valve_set"]}
    file = load(PlantConfig, config_dir / "plant.yaml", overrides)
    known = parameters_of(file, JOINTS)
    theta = drawn_theta(known, np.random.default_rng(task["seed"]))
    data = changed(base_of(file), known, theta)
    data["step_ms"] = FINE_STEP_MS
    true_plant, overlap = PlantConfig.model_validate(data), widest_overlap(file)
    machine = _MACHINE._replace(valve_set=task["valve_set"])
    recording = record(true_plant, machine, standard(overlap), held_out(overlap), task["seed"])
    found = identify(file, recording, check_recording(recording, machine))
    signals = validate(found, recording)
    check_believable(found, signals)
    check_noise(signals)
    angles = [signal for signal in signals if signal.signal.endswith("angle")]
    return _row(task["seed"], found, theta)._replace(
        fit=min(signal.fit for signal in angles),
        before=min(signal.before for signal in angles),
        white=min(signal.white for signal in signals),
    )


def _row(seed: int, found: Identified, theta: Array) -> IdentifiedRow:
    n = len(theta)
    off, P = found.whole.theta[:n] - theta, found.whole.covariance[:n, :n]
    sigmas = np.abs(off) / np.sqrt(np.diag(P))
    worst = int(np.argmax(sigmas))
    return IdentifiedRow(
        seed=seed,
        parameters=n,
        identified=sum(one.identified for one in findings(found)),
        nees=float(off @ np.linalg.solve(P, off)) / n,
        outside=int(np.sum(sigmas > 3.0)),
        worst_sigma=float(sigmas[worst]),
        worst=found.problem.parameters[worst].name,
        chi2=excess(found),
        fit=float("nan"),
        before=float("nan"),
        promised=found.whole.promised,
        white=float("nan"),
    )


def draw_tasks(request: CampaignRequest, settings: DrawSettings) -> list[Task]:
    """One task a seed."""
    return [{"key": f"{seed}", "seed": seed, "valve_set": settings.valve_set} for seed in seeds(request)]


def draw_table(done: Drawn) -> list[Table]:
    """Each plant."""
    columns: Columns = {
        "seed": "{seed}",
        "identified": "{identified} of {parameters}",
        "NEES": "{nees:.2f}",
        "outside 3 σ": "{outside}",
        "furthest": "{worst}",
        "σ": "{worst_sigma:.1f}",
        "χ²": "{chi2:.2f}",
        "held out %, file": lambda row: f"{100.0 * row.before:.0f}",
        "fitted": lambda row: f"{100.0 * row.fit:.2f}",
        "CPU s": "{cpu_s:.0f}",
    }
    return [listed("plants drawn from the priors, identified from one recording each", columns, done.rows)]


def draw_verdict(done: Drawn) -> list[Check]:
    """None wrong and not refused; of those identified all parameters within 3 σ, NEES in its band, motion
    predicted, within six minutes of one core."""
    good = [row for row in done.rows if not row.failure]
    if not good:
        return [Check("plants identified", "0", f"{len(done.rows)}", False)]
    return [
        Check("plants identified", f"{len(good)}", f"{len(done.rows)}", len(good) == len(done.rows)),
        at_most("wrong and not refused", float(sum(row.nees > _WRONG for row in good)), 0.0),
        at_most("parameters outside 3 σ", float(sum(row.outside for row in good)), 0.0),
        inside("NEES, mean", float(np.mean([row.nees for row in good])), (0.8, 1.25)),
        at_least("held-out motion predicted, least", 100.0 * min(row.fit for row in good), 99.0, "%"),
        at_most("CPU time of a run, most", max(row.cpu_s for row in good), 360.0, "s"),
    ]


IDENTIFICATION = Experiment(
    name="identification",
    title="Plants drawn from the priors, identified from one recording each.",
    settings=DrawSettings,
    row=IdentifiedRow,
    tasks=draw_tasks,
    run=identified_plant,
    table=draw_table,
    verdict=draw_verdict,
    runs=20,
    seed=40001,
    world="the plant alone, every fitted parameter drawn from its prior",
    eyes="none",
)
