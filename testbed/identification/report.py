"""What `longreach identify` shows: the tables of each stage."""

from collections.abc import Sequence

from rich.table import Table

from plant_emulator.core.layout import JOINTS
from testbed.identification.findings import FittedNumber
from testbed.identification.fit import Simple
from testbed.identification.validation import SignalFit
from testbed.reporting.console import Columns, listed, table


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
    """Every parameter with its σ, identified or kept at the prior."""
    columns: Columns = {
        "parameter": "{name}",
        "unit": "{unit}",
        "file": "{file:.4g}",
        "fitted": "{fitted:.5g}",
        "σ": "{std:.2g}",
        "σ %": lambda f: f"{f.percent:.2g}" if f.percent < 1e3 else "–",
        "": "{told}",
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
