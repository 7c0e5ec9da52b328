"""What a fit found, parameter by parameter, in the units of the plant file: value, σ, identified or fixed."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from rich.table import Table

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.layout import JOINTS
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from testbed.identification.fit import IDENTIFIED_BELOW, Identified, Simple
from testbed.identification.parameters import Key, Parameter, changed, value
from testbed.identification.recording import MotionRecording
from testbed.identification.validation import SignalFit
from testbed.reporting.console import Columns, listed, table


class FittedNumber(NamedTuple):
    """One parameter: the file's number, the reported one and its σ in ``unit``; σ over the prior's spread.

    ``fixed``: it is the file's number and the prior's σ.
    """

    name: str
    unit: str
    file: float
    fitted: float
    std: float
    of_prior: float
    source: str
    fixed: bool

    @property
    def identified(self) -> bool:
        """Whether the recording tells it."""
        return not self.fixed and self.of_prior < IDENTIFIED_BELOW

    @property
    def status(self) -> str:
        """How the number was come by."""
        if self.fixed:
            return "fixed at the prior"
        return "identified" if self.identified else "only with those fixed"

    @property
    def percent(self) -> float:
        """σ in per cent of the fitted number."""
        return 100.0 * self.std / abs(self.fitted) if self.fitted else math.inf


def excess(found: Identified) -> float:
    """χ² of what is left over the number of samples: 1 where noise alone is left."""
    return found.whole.data / (found.whole.samples - len(found.whole.theta))


def findings(found: Identified) -> list[FittedNumber]:
    """Every parameter of the machine, in the fit's order."""
    stds = np.sqrt(np.diag(found.whole.covariance))
    return [
        _finding(parameter, found, index, float(stds[index]))
        for index, parameter in enumerate(found.problem.parameters)
        if not parameter.of_start
    ]


def _finding(parameter: Parameter, found: Identified, index: int, std: float) -> FittedNumber:
    base = found.problem.base
    fitted = value(base, parameter, float(found.whole.theta[index]))
    return FittedNumber(
        parameter.name,
        parameter.unit,
        value(base, parameter, 0.0),
        fitted,
        std * abs(fitted) if parameter.kind == "factor" else std,
        std / parameter.spread,
        parameter.source,
        index in found.whole.fixed,
    )


def first_stages(simple: Simple) -> list[Table]:
    """Dead zones, friction and load, oil and edges, as the simple stages found them."""
    zones: Columns = {
        "valve": "{name}",
        "dead zone %": lambda z: f"{100.0 * z.deadband:.3f} ± {100.0 * z.deadband_std:.3f}",
        "opening − closing %": lambda z: f"{200.0 * z.hysteresis:+.3f}",
        "samples": "{samples}",
    }
    shown = [listed("stage 1: where the flow begins", zones, simple.dead_zones)]
    if simple.balance is not None:
        rows = [
            (
                JOINTS[f.joint],
                f"{f.coulomb:.0f} ± {f.coulomb_std:.0f}",
                f"{f.viscous:.0f} ± {f.viscous_std:.0f}",
            )
            for f in simple.balance.frictions
        ]
        title = f"stage 1: friction; payload {simple.balance.more_kg:+.1f} kg against the file"
        shown.append(table(title, ("joint", "Coulomb N, N m", "viscous N s/m, N m s"), rows))
    flows: Columns = {
        "joint": "{name}",
        "flow +, of the file's": lambda f: f"{f.extend:.3f} ± {f.extend_std:.3f}",
        "flow −": lambda f: f"{f.retract:.3f} ± {f.retract_std:.3f}",
        "leakage m³/s/Pa": "{leakage:.2g}",
    }
    p = simple.pressures
    title = f"stage 2: chambers; bulk modulus {p.modulus / 1e6:.0f} ± {p.modulus_std / 1e6:.0f} MPa"
    return [*shown, listed(title, flows, p.flows)]


def found_table(found: Sequence[FittedNumber]) -> Table:
    """Every parameter with its σ, identified or fixed at the prior."""
    columns: Columns = {
        "parameter": "{name}",
        "unit": "{unit}",
        "file": "{file:.4g}",
        "fitted": "{fitted:.5g}",
        "σ": "{std:.2g}",
        "σ %": lambda f: f"{f.percent:.2g}" if f.percent < 1e3 else "–",
        "": "{status}",
    }
    return listed("stage 3: the most probable plant", columns, found)


def validation_table(signals: Sequence[SignalFit]) -> Table:
    """Each signal on held-out motion."""
    columns: Columns = {
        "signal": "{signal}",
        "fit %, file": lambda s: f"{100.0 * s.before:.1f}",
        "fit %, fitted": lambda s: f"{100.0 * s.fit:.2f}",
        "residual / noise": "{rms_over_noise:.2f}",
        "white %": lambda s: f"{100.0 * s.white:.0f}",
    }
    return listed("stage 4: held-out motion, predicted in one run (100 % is perfect)", columns, signals)


def write_plant_file(
    path: Path, found: Identified, config: PlantConfig, recording: MotionRecording, sure: bool = True
) -> PlantConfig:
    """Write ``config`` with what was fitted in it to ``path``; the plant that loads from there.

    A parameter that the recording does not tell keeps the file's number. Not ``sure``: σ do not hold, and are
    not written. Raises ConfigurationError when the
    file cannot be written.
    """
    numbers = {finding.name: finding for finding in findings(found)}
    pairs = zip(found.problem.parameters, found.whole.theta, strict=True)
    machine = [(p, theta) for p, theta in pairs if not p.of_start]
    data = changed(found.problem.base, [p for p, _ in machine], np.array([theta for _, theta in machine]))
    data["step_ms"] = _step_ms(data, config.step_ms)
    notes = {
        key: _provenance(numbers[p.name], recording, sure)
        for p, _ in machine
        if not numbers[p.name].fixed
        for key in p.keys
    }
    lines = [
        f"# Identified from a recording of '{recording.about.arm}', sha256 {recording.sha256}.",
        f"# [I {'±σ' if sure else 'σ unknown'}, recording]: fitted to it."
        " All else is as in the plant file that the fit began with.",
        *_lines(data, (), notes),
    ]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{path}: {error.strerror}") from error
    return load(PlantConfig, path)


def _step_ms(data: dict[str, Any], wished: float) -> float:
    """``wished`` where the plant of ``data`` is stable with it, else the step that it was fitted with."""
    try:
        Plant(PlantConfig.model_validate(data | {"step_ms": wished}), seed=0)
    except (ConfigurationError, ValueError):
        return float(data["step_ms"])
    return wished


def _provenance(finding: FittedNumber, recording: MotionRecording, sure: bool) -> str:
    spread = f"{finding.percent:.2g} %" if finding.percent < 100.0 else f"{finding.std:.2g} {finding.unit}"
    sigma = f"±{spread}" if sure else "σ unknown"
    return f"[I {sigma}, recording {recording.sha256[:12]}]"


def _lines(data: Any, path: Key, notes: dict[Key, str], depth: int = 0) -> list[str]:
    """``data`` as YAML in blocks, a note behind each entry that has one; '*' is any place in a list."""
    found: list[str] = []
    pad = "  " * depth
    for name, item in data.items():
        here = (*path, name)
        if isinstance(item, dict) and item:
            found += [f"{pad}{name}:", *_lines(item, here, notes, depth + 1)]
        elif isinstance(item, list) and item and isinstance(item[0], dict):
            found.append(f"{pad}{name}:")
            for entry in item:
                first, *rest = _lines(entry, (*here, "*"), notes, depth + 2)
                found += [f"{pad}  - {first.strip()}", *rest]
        else:
            note = notes.get(here) or next((n for k, n in notes.items() if k[: len(here)] == here), "")
            text = yaml.safe_dump(item, default_flow_style=True, width=1 << 20).removesuffix("...\n").strip()
            found.append(f"{pad}{name}: {text}" + (f" # {note}" if note else ""))
    return found
