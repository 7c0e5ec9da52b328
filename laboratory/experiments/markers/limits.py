"""`longreach experiment eyes-measure --method markers`: how small, oblique, blurred and noisy
square markers may be, and what that costs, beside OpenCV's and AprilTag's readers on the same pictures.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, at_most, inside, seeds
from laboratory.experiments.markers.one_picture import (
    AXES,
    EMPTY,
    EMPTY_NOISE,
    FAMILIES,
    PEERS,
    PUPIL,
    TIME,
    TIMED,
    WORDS,
    LimitRow,
    aspect_of,
    one_picture,
)
from protocol.errors import ConfigurationError
from testbed.reporting.console import table

LONG_PX = 16.0  # sides from here on: corners are to be ahead
TRACKED_MS, FULL_MS = 6.0, 20.0
FEWEST = 18  # markers that both found, below which their rms is not compared
FINDERS = ("ours", "subpix", "apriltag", PUPIL)  # cv2 finds alike with none, subpix and contour
_READERS = ("ours", *PEERS)
HEADS = (
    "markers",
    *(f"found: {name}" for name in FINDERS),
    *(f"rms px: {name}" for name in _READERS),
)


class LimitSettings(NamedTuple):
    """Which markers, and along which axes."""

    family: Annotated[str, typer.Option(help="The dictionary of markers.")] = "DICT_APRILTAG_36h11"
    axis: Annotated[list[str], typer.Option(help="Only this axis; repeatable.")] = []  # noqa: RUF012


Rows = Finished[LimitSettings, LimitRow]


def limit_tasks(request: CampaignRequest, settings: LimitSettings) -> list[Task]:
    """A picture for each value of each axis and seed, four empty ones, one for the time.

    Raises ConfigurationError for an axis or a family that there is not.
    """
    known = (*AXES, EMPTY, TIME)
    if unknown := [axis for axis in settings.axis if axis not in known]:
        raise ConfigurationError(
            "configuration.unknown_axis", f"--axis {unknown[0]}: one of {', '.join(known)} is wanted"
        )
    if settings.family not in FAMILIES:
        raise ConfigurationError(
            "configuration.unknown_dictionary",
            f"--family {settings.family}: one of {', '.join(FAMILIES)} is wanted",
        )
    values = AXES | {EMPTY: EMPTY_NOISE, TIME: (0.0,)}
    return [
        {
            "key": f"{settings.family}-{axis}-{value:g}-{seed}",
            "family": settings.family,
            "axis": axis,
            "value": value,
            "seed": seed,
        }
        for axis in settings.axis or known
        for value in values[axis]
        for seed in seeds(request)
    ]


def limit_table(done: Rows) -> list[Table]:
    """Recall and corner rms of every reader by axis and value; false markers; time."""
    tables = ((WORDS[axis], by_value(done.rows, axis)) for axis in AXES)
    made = [
        table(words, [words, *HEADS], [line(*one) for one in values]) for words, values in tables if values
    ]
    rest = summary(done.rows)
    return [*made, table("false markers and time", ("", *_READERS), rest)] if rest else made


def by_value(rows: Sequence[LimitRow], axis: str) -> list[tuple[float, list[LimitRow]]]:
    """Rows of ``axis`` that did not fail, by their value."""
    found = [row for row in rows if row.axis == axis and not row.failure]
    return [
        (value, [row for row in found if row.value == value])
        for value in sorted({row.value for row in found})
    ]


def line(value: float, rows: Sequence[LimitRow]) -> list[str]:
    """A line of the table of an axis."""
    count = sum(row.markers for row in rows)
    cells = [f"{value:g}", str(count)]
    for name in FINDERS:
        share = total(rows, name, "found") / count
        cells.append(f"{share:.1%}" if np.isfinite(share) else "")
    for name in _READERS:
        found, square = total(rows, name, "found"), total(rows, name, "square")
        cells.append(f"{np.sqrt(square / found / 8.0):.3f}" if found > 0 else "")
    return cells


def total(rows: Sequence[LimitRow], name: str, column: str) -> float:
    """Sum of a reader's column; NaN where it was not there."""
    return float(sum(getattr(getattr(row, name), column) for row in rows))


def summary(rows: Sequence[LimitRow]) -> list[list[str]]:
    """False markers of each reader in pictures with and without markers, and its time."""
    good = [row for row in rows if not row.failure]
    empty = [row for row in good if row.axis == EMPTY]
    full = [row for row in good if row.axis in AXES]
    timed = [row for row in good if row.axis == TIME]
    made = []
    for words, of in (("false, in pictures without markers", empty), ("… with markers", full)):
        if of:
            cells = [f"{total(of, name, 'false'):.0f}" for name in _READERS]
            made.append([f"{words}: {len(of)}", *cells])
    if timed:
        cells = [f"{_middle_ms(timed, name):.1f}" for name in _READERS]
        made.append([f"CPU ms, {TIMED} markers in 720p", *cells])
    return made


def _middle_ms(rows: Sequence[LimitRow], name: str) -> float:
    return float(np.median([getattr(row, name).ms for row in rows]))


def limit_verdict(done: Rows) -> list[Check]:
    """At or above every peer in recall at equal false markers, ahead in rms from 16 px on, and quick."""
    good = [row for row in done.rows if not row.failure]
    seen = [row for row in good if row.axis in AXES]
    empty = [row for row in good if row.axis == EMPTY]
    checks = [at_most("runs that failed", len(done.rows) - len(good), 0.0)]
    there = [name for name in PEERS if np.isfinite(total(seen[:1] + empty[:1], name, "found"))]
    if seen:
        checks += _recall(seen, there) + _ahead(seen, there)
        corners = 8.0 * total(seen, "ours", "found")
        checks.append(
            inside("corners: error² / variance told", sum(row.nees for row in seen) / corners, None)
        )
    for words, rows in (("without", empty), ("with", seen)):
        if rows and there:
            least = min(total(rows, name, "false") for name in there)
            title = f"false markers in {len(rows)} pictures {words} markers"
            checks.append(at_most(title, total(rows, "ours", "false"), least))
    timed = [row for row in good if row.axis == TIME]
    return checks + (_quick(timed) if timed else [])


def _recall(rows: Sequence[LimitRow], there: Sequence[str]) -> list[Check]:
    """Of each axis the share found, beside the peer that found most."""
    checks = []
    for axis in AXES:
        of = [row for row in rows if row.axis == axis]
        if count := sum(row.markers for row in of):
            best, most = max(
                ((name, total(of, name, "found") / count) for name in there),
                key=lambda one: one[1],
                default=("", None),
            )
            beside = f", beside {best}" if best else ""
            share = total(of, "ours", "found") / count
            checks.append(at_least(f"found over {WORDS[axis]}{beside}", share, most))
    return checks


def _ahead(rows: Sequence[LimitRow], there: Sequence[str]) -> list[Check]:
    """rms of ours over that of each peer on the markers that both found, where that is worst."""
    checks = []
    for name in there:
        ratios = [
            (_ratio(of, name), f"{WORDS[axis]} {value:g}")
            for axis in AXES
            for value, of in by_value(rows, axis)
            if aspect_of(axis, value).side_px >= LONG_PX and total(of, name, "shared") >= FEWEST
        ]
        if ratios:
            ratio, where = max(ratios)
            checks.append(at_most(f"corner rms over that of {name}, worst at {where}", ratio, 1.0))
    return checks


def _ratio(rows: Sequence[LimitRow], name: str) -> float:
    return float(np.sqrt(total(rows, name, "ours_square") / total(rows, name, "shared_square")))


def _quick(rows: Sequence[LimitRow]) -> list[Check]:
    peer = _middle_ms(rows, "subpix")
    tracked = float(np.median([row.tracked_ms for row in rows]))
    known = float(np.median([row.known_ms for row in rows]))
    return [
        at_most("CPU of a tracked 720p picture", tracked, TRACKED_MS, "ms"),
        at_most("… over cv2 SUBPIX anywhere", tracked / peer, None),
        at_most("CPU of a full 720p picture, numbers known", known, FULL_MS, "ms"),
        at_most("… over cv2 SUBPIX anywhere", known / peer, 1.0),
    ]


MARKER_LIMITS = Experiment(
    name="marker-limits",
    title="How small, oblique, blurred and noisy square markers may be, beside OpenCV and AprilTag.",
    settings=LimitSettings,
    row=LimitRow,
    tasks=limit_tasks,
    run=one_picture,
    table=limit_table,
    verdict=limit_verdict,
    runs=5,
    seed=1,
    world="18 markers a picture, light, ground, place, turn and tilt drawn",
    eyes="rendered pictures",
    workers=0,
)
