"""What the odometry matrix's rows are, and what they say: a line a kind, and the verdict over all."""

from collections.abc import Collection, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from laboratory.campaigns.experiment import Check, Finished, at_least, at_most, inside
from laboratory.experiments.odometry.open_worlds import OPEN_KINDS
from laboratory.experiments.odometry.real_sequences import REAL_KINDS
from laboratory.experiments.odometry.sequences import KINDS
from testbed.reporting.console import table
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.shell.cameras.sequence import SequenceResult

FLOOR_M, FLOOR_RAD = 1e-3, np.radians(0.1)
"""Errors below these are nobody's harm, whatever was predicted."""
SIGMAS = 3.0
GROSS_M = 0.03
"""An error that is wrong without any σ; half a pixel of disparity makes 15 mm of a metre."""
FREEDOM = 6


class Judged(NamedTuple):
    """``located`` poses, ``wrong`` beyond what was predicted, ``gross`` errors, the greatest error m, the
    median predicted standard deviation m, and the mean error² over variance (6: honest); NaN where none.
    """

    located: int
    wrong: int
    gross: int
    worst_m: float
    predicted_m: float
    nees: float


def judged(result: SequenceResult, true: Array) -> Judged:
    """``result`` against the ``true`` poses (n, 4, 4) of its pairs, each map from its own first pair on, and
    where maps were joined also from the first map's.
    """
    firsts: dict[int, Array] = {}
    held: set[int] = set()
    found: list[tuple[Array, Array]] = []
    for record in result.records:
        if record.pose is None or record.segment is None:
            continue
        here = true[record.frame_id]
        if record.segment not in firsts:
            firsts[record.segment] = here @ se3.inverse(record.pose.X_C0C)
            continue
        error = se3.local(se3.inverse(firsts[record.segment]) @ here, record.pose.X_C0C)
        found.append((error, record.pose.covariance))
        held.add(record.segment)
    located = len(found) + len(held)  # a map of one pair tells no place
    return _sum_up(located, found)


def _sum_up(located: int, found: Sequence[tuple[Array, Array]]) -> Judged:
    if not found:
        return Judged(located, 0, 0, 0.0, float("nan"), float("nan"))
    away = [float(np.linalg.norm(error[:3])) for error, _ in found]
    predicted = [float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])) for _, covariance in found]
    nees = [float(error @ np.linalg.solve(covariance, error)) for error, covariance in found]
    return Judged(
        located,
        sum(is_wrong(*one) for one in found),
        sum(length > GROSS_M for length in away),
        max(away),
        float(np.median(predicted)),
        float(np.mean(nees)),
    )


def is_wrong(error: Array, covariance: Array) -> bool:
    """Whether ``error`` (6,) is beyond the floor and beyond what was predicted, in place or in rotation."""
    parts = ((slice(0, 3), FLOOR_M), (slice(3, 6), FLOOR_RAD))
    return any(_beyond(error[part], covariance[part, part], floor) for part, floor in parts)


def _beyond(error: Array, covariance: Array, floor: float) -> bool:
    size = float(np.linalg.norm(error))
    if size <= floor:
        return False
    along = error / size
    return size > SIGMAS * float(np.sqrt(along @ covariance @ along))


def gross(found: Sequence[tuple[int, Array]], true: Array) -> tuple[int, float]:
    """How many of ``found`` (pair, X_C0C) are grossly off, from the first of them on; the greatest error m.

    Of a peer that tells neither losses of its map nor any σ: all its poses count as one trajectory.
    """
    if not found:
        return 0, 0.0
    begin = true[found[0][0]] @ se3.inverse(found[0][1])
    away = [float(np.linalg.norm((begin @ X)[:3, 3] - true[k][:3, 3])) for k, X in found]
    return sum(length > GROSS_M for length in away), max(away)


NEES_BAND = (0.7, 1.5)
LEAST_LOCATED = 0.95
_NAN = float("nan")


class MatrixSettings(NamedTuple):
    """Which kinds, how long, whether beside the peer, and whether real pictures too."""

    kind: Annotated[list[str], typer.Option(help="Only these kinds; may be given again.")] = []  # noqa: RUF012
    pairs: Annotated[int, typer.Option(help="Pairs of a sequence, over 1.1 m.", min=12, max=600)] = 40
    peer: Annotated[bool, typer.Option(help="ORB-SLAM3 on the same pictures, where it is installed.")] = True
    real: Annotated[bool, typer.Option(help="Real pictures too, where LONGREACH_DATA has them.")] = True


class MatrixRow(NamedTuple):
    """One sequence. ``wrong``: pairs located, but off by more than three standard deviations and a floor.

    ``gross``: off by more than 30 mm, whatever was predicted. ``nees`` the mean error² over variance;
    ``peer_`` of ORB-SLAM3.
    """

    kind: str
    seed: int
    pairs: int
    located: int
    maps: int
    losses: str
    ate_mm: float
    worst_mm: float
    predicted_mm: float
    wrong: int
    gross: int
    nees: float
    ms: float
    peer_located: float
    peer_ate_mm: float
    peer_worst_mm: float
    peer_gross: float
    peer_ms: float
    failure: str = ""
    cpu_s: float = _NAN


Rows = Finished[MatrixSettings, MatrixRow]


def _mean(rows: list[MatrixRow], column: str) -> float:
    values = [float(getattr(row, column)) for row in rows]
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else _NAN


def _middle(rows: list[MatrixRow], column: str) -> float:
    known = [value for row in rows if np.isfinite(value := float(getattr(row, column)))]
    return float(np.median(known)) if known else _NAN


def matrix_table(done: Rows) -> list[Table]:
    """A line a kind, over its seeds: medians, but worst errors, counts of pairs, and mean NEES."""
    heads = ["kind", "located", "ATE mm", "worst mm", "predicted σ mm", "wrong", "NEES/6", "ms a pair"]
    heads += [f"ORB-SLAM3: {name}" for name in ("located", "ATE mm", "worst mm", "> 30 mm", "ms")]
    made = [table("odometry of recordings", heads, [_line(*one) for one in _by_kind(done, KINDS)])]
    if opened := [_line(*one) for one in _by_kind(done, OPEN_KINDS)]:
        made.append(table("roads and rooms, rendered", heads, opened))
    if real := [_line(*one) for one in _by_kind(done, REAL_KINDS)]:
        made.append(table("real pictures, against a camera at rest", heads, real))
    return made


def _line(name: str, rows: list[MatrixRow]) -> list[str]:
    pairs = sum(row.pairs for row in rows)
    peers = [row for row in rows if np.isfinite(row.peer_located)]
    seen = sum(row.pairs for row in peers)
    return [
        _words(name),
        f"{sum(row.located for row in rows) / pairs:.0%}",
        _number(_middle(rows, "ate_mm")),
        _number(max(row.worst_mm for row in rows)),
        _number(_middle(rows, "predicted_mm")),
        str(sum(row.wrong for row in rows)),
        _number(_mean(rows, "nees") / FREEDOM),
        _number(_middle(rows, "ms"), 0),
        f"{sum(row.peer_located for row in peers) / seen:.0%}" if seen else "",
        _number(_middle(peers, "peer_ate_mm")),
        _number(max((row.peer_worst_mm for row in peers), default=_NAN)),
        f"{sum(row.peer_gross for row in peers):.0f}" if seen else "",
        _number(_middle(peers, "peer_ms"), 0),
    ]


def _words(name: str) -> str:
    if name in OPEN_KINDS:
        return OPEN_KINDS[name].words
    return (REAL_KINDS if name in REAL_KINDS else KINDS)[name].words


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def _by_kind(done: Rows, of: Collection[str]) -> list[tuple[str, list[MatrixRow]]]:
    kinds = {name: [row for row in done.rows if row.kind == name and not row.failure] for name in of}
    return [(name, rows) for name, rows in kinds.items() if rows]


def matrix_verdict(done: Rows) -> list[Check]:
    """No overconfident errors; what cannot be used is refused; errors are as large as predicted."""
    kinds = dict(_by_kind(done, KINDS))
    usable = [row for name, rows in kinds.items() for row in rows if not KINDS[name].refused]
    useless = [row for name, rows in kinds.items() for row in rows if KINDS[name].refused]
    pairs = sum(row.pairs for row in usable)
    checks = [at_most("runs that failed", sum(bool(row.failure) for row in done.rows), 0.0)]
    if usable:
        checks += [
            at_most(f"overconfident errors, of {pairs} pairs", sum(row.wrong for row in usable), 0.0),
            inside("error² / predicted variance, over the kinds", _nees(usable), NEES_BAND),
        ]
    if useless:
        located = sum(row.located for row in useless)
        checks.append(at_most("pairs located that nobody can locate", located, 0.0))
    if still := kinds.get("still_wall"):
        checks.append(
            at_most("ATE on the still wall, calibration exact", _middle(still, "ate_mm"), 0.1, "mm")
        )
    return checks + _beside(usable) + _open(done) + _real(done)


def _open(done: Rows) -> list[Check]:
    """The same of roads and rooms, where they were asked for; ATE beside the peer's where that ran."""
    rows = [row for _, rows in _by_kind(done, OPEN_KINDS) for row in rows]
    if not rows:
        return []
    pairs = sum(row.pairs for row in rows)
    checks = [
        at_most(
            f"roads and rooms: overconfident errors, of {pairs} pairs", sum(row.wrong for row in rows), 0.0
        ),
        at_least("roads and rooms: located", sum(row.located for row in rows) / pairs, LEAST_LOCATED),
        inside("roads and rooms: error² / predicted variance", _nees(rows), NEES_BAND),
    ]
    if known := [row for row in rows if row.ate_mm > 0.0 and row.peer_ate_mm > 0.0]:
        ratio = float(np.median([row.ate_mm / row.peer_ate_mm for row in known]))
        checks.append(at_most("roads and rooms: ATE over ORB-SLAM3's, median", ratio, 1.0))
    return checks


def _beside(rows: list[MatrixRow]) -> list[Check]:
    """Gross errors of ours and of the peer, where it ran."""
    known = [row for row in rows if np.isfinite(row.peer_gross)]
    words = ("off by more than 30 mm", "pairs")
    return [
        at_most(f"{words[0]}: Longreach", sum(row.gross for row in known), None, words[1]),
        at_most(f"{words[0]}: ORB-SLAM3", sum(row.peer_gross for row in known), None, words[1]),
    ] if known else []  # fmt: skip


def _real(done: Rows) -> list[Check]:
    """The same of real pictures, where there were any."""
    kinds = _by_kind(done, REAL_KINDS)
    if not kinds:
        return []
    usable = [row for name, rows in kinds for row in rows if not REAL_KINDS[name].refused]
    useless = [row for name, rows in kinds for row in rows if REAL_KINDS[name].refused]
    pairs = sum(row.pairs for row in usable)
    checks = [at_most(f"real: overconfident errors, of {pairs} pairs", sum(row.wrong for row in usable), 0.0)]
    if useless:
        found = sum(row.located for row in useless)
        checks.append(at_most("real: pairs located that nobody can locate", found, 0.0))
    checks.append(Check("real: pairs located", str(sum(row.located for row in usable)), "", None))
    if known := [row for row in usable if np.isfinite(row.peer_located)]:
        peers = f"{sum(row.peer_located for row in known):.0f}, {sum(row.peer_gross for row in known):.0f} of"
        checks.append(Check("real: pairs located by ORB-SLAM3", f"{peers} them 30 mm off", "", None))
    return checks


def _nees(rows: list[MatrixRow]) -> float:
    """Relative to its expectation; every kind weighs alike. NaN where every pair was lost."""
    kinds = sorted({row.kind for row in rows})
    means = [_mean([row for row in rows if row.kind == kind], "nees") for kind in kinds]
    known = [value for value in means if np.isfinite(value)]
    return float(np.mean(known)) / FREEDOM if known else _NAN


def matrix_figures(done: Rows) -> dict[str, Any]:
    """NEES over its expectation by kind."""
    return {"nees": {name: _mean(rows, "nees") / FREEDOM for name, rows in _by_kind(done, KINDS)}}
