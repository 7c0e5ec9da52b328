"""`longreach target`: a marker or board on a page of paper at true scale, with rulers that tell whether the
printer kept it.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from protocol.errors import RequestRefused
from testbed.pictures.target_shapes import TargetShape
from testbed.reporting.console import out, write_json
from vision_pc.core.se3 import Array

PAPERS_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}  # [S] ISO 216, ANSI Y14.1
_MARGIN_MM = 5.0  # [D] printers leave 3 to 4.2 mm white
_LEFT_MM, _BELOW_MM = 9.0, 14.0  # [D] the strips of the rulers
_RULER_MM = 100
_INCH_MM = 25.4


class Page(NamedTuple):
    """``size_mm`` (width, height) of the paper, ``corner_mm`` (x, y) the target's upper left one on it, from
    the paper's upper left corner.
    """

    size_mm: tuple[float, float]
    corner_mm: tuple[float, float]


def placed(shape: TargetShape, paper: str, size_mm: float) -> Page:
    """Where the target lies on the paper, upright or across; ``size_mm`` is what was asked for.

    Raises RequestRefused: ``refused.target.paper``, ``refused.target.does_not_fit``.
    """
    if paper not in PAPERS_MM:
        raise RequestRefused("refused.target.paper", f"{paper!r}: one of {', '.join(PAPERS_MM)} is wanted")
    needed = np.array(shape.size_mm) + 2.0 * shape.quiet_mm
    scales = []
    for size in (PAPERS_MM[paper], PAPERS_MM[paper][::-1]):
        free = np.array(size) - 2.0 * _MARGIN_MM - (_LEFT_MM, _BELOW_MM)
        scales.append(float((free / needed).min()))
        if scales[-1] >= 1.0:
            x, y = (_MARGIN_MM + _LEFT_MM, _MARGIN_MM) + 0.5 * (free - np.array(shape.size_mm))
            return Page(size, (float(x), float(y)))
    largest = np.floor(10.0 * size_mm * max(scales)) / 10.0
    raise RequestRefused(
        "refused.target.does_not_fit",
        f"{shape.told}: {needed[0]:.1f} x {needed[1]:.1f} mm with the white around; with its rulers {paper} "
        f"has room for --size-mm {largest:g} at most",
    )


def run_target(shape: TargetShape, paper: str, size_mm: float, to: Path, json_file: Path | None) -> None:
    """Write the page. Raises RequestRefused where it cannot be, OSError where the file cannot."""
    if to.suffix.lower() != ".pdf":
        raise RequestRefused("refused.target.format", f"{to}: a name that ends in .pdf is wanted")
    page = placed(shape, paper, size_mm)
    _draw(shape, page, to)
    width, height = page.size_mm
    out.print(f"{to}: {shape.told}, on {paper} ({width:g} x {height:g} mm)", highlight=False, soft_wrap=True)
    out.print(
        f"print it at 100 % (not 'fit to page'); both rulers must measure {_RULER_MM} mm, else give the "
        "measured size to what reads the pictures",
        highlight=False,
        soft_wrap=True,
    )
    write_json(json_file, page._asdict() | {"told": shape.told, "target_mm": shape.size_mm, "paper": paper,
                                            "cells_mm": len(shape.cells)})  # fmt: skip


def _draw(shape: TargetShape, page: Page, to: Path) -> None:
    width, height = page.size_mm
    figure = Figure(figsize=(width / _INCH_MM, height / _INCH_MM), frameon=False)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0.0, width)
    axes.set_ylim(height, 0.0)
    axes.axis("off")
    _fill(axes, shape.cells + np.array([*page.corner_mm, 0.0, 0.0]))
    _fill(axes, _ruler(_MARGIN_MM + _LEFT_MM, height - _MARGIN_MM - 8.0))
    _fill(axes, _ruler(_MARGIN_MM, _MARGIN_MM)[:, [1, 0, 3, 2]])
    axes.text(
        _MARGIN_MM + _LEFT_MM, height - _MARGIN_MM, f"{shape.told}. Print at 100 %: both rulers are "
        f"{_RULER_MM} mm.", fontsize=7, va="bottom",
    )  # fmt: skip
    figure.savefig(to, format="pdf", metadata={"CreationDate": None})


def _ruler(x: float, y: float) -> Array:
    """A tick a millimetre from ``x`` on, downwards to ``y``, longer ones at 5 and 10."""
    ticks = []
    for k in range(_RULER_MM + 1):
        length = 4.0 if k % 10 == 0 else 3.0 if k % 5 == 0 else 2.0
        ticks.append((x + k - 0.05, y, 0.1, length))
    return np.array([*ticks, (x, y - 0.05, float(_RULER_MM), 0.1)])


def _fill(axes: Axes, cells: Array) -> None:
    """Fill the cells as one path, so that no viewer shows seams between neighbours."""
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)])
    points = cells[:, None, :2] + corners * cells[:, None, 2:]
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY] * len(cells)
    axes.add_patch(PathPatch(Outline(points.reshape(-1, 2), codes), facecolor="black", linewidth=0.0))
