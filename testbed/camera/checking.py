"""Whether a stereo camera is as its file says, and whether a board is the one that was asked for."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from protocol.errors import RequestRefused
from testbed.camera.pairs import Taken, boards_in, take
from testbed.reporting.console import out, table, write_json
from vision_pc.config.camera import PinholePair
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception import intrinsics, look, pair_check
from vision_pc.core.perception.april_grid import Board
from vision_pc.core.perception.pair_check import PictureReport, RowReport, board_offset
from vision_pc.core.perception.rectification import Rectifier, refuse_size
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.perception.zhang_intrinsics import Checkerboard
from vision_pc.core.types import FrameObservation, Image, PointPairs, StereoOffset, StereoPair

_LOOKED_AT = 5
_SMALLEST = (3, 3)


def counts_shown(pictures: Sequence[Image]) -> tuple[int, int] | None:
    """The inner corners, more by fewer, of the checkerboard that most of a few pictures show whole; None
    where they do not agree.
    """
    chosen = np.unique(np.linspace(0, len(pictures) - 1, min(_LOOKED_AT, len(pictures))).round().astype(int))
    seen: Counter[tuple[int, int]] = Counter()
    for k in chosen:
        found, _, meta = cv2.findChessboardCornersSBWithMeta(pictures[k], _SMALLEST, cv2.CALIB_CB_LARGER)
        if found and min(meta.shape) > min(_SMALLEST):  # so few corners are in any texture
            seen[max(meta.shape), min(meta.shape)] += 1
    most = seen.most_common(1)
    return most[0][0] if most and 2 * most[0][1] > seen.total() else None


def question(pictures: Sequence[Image], board: Board, found: int) -> None:
    """Say what is doubtful about ``board``, of which ``found`` pictures show one.

    Raises RequestRefused (``refused.board.counts``) where another one is there, and none is found, or
    ``board`` is but a part of it: it may be another part in every picture.
    """
    if not isinstance(board, Checkerboard):
        return
    board_size = (max(board.columns, board.rows), min(board.columns, board.rows))
    shown = counts_shown(pictures)
    if shown is not None and shown != board_size:
        why = (
            f"the pictures show a board of {shown[0]}x{shown[1]} inner corners, asked for are "
            f"{board.columns}x{board.rows}: --columns and --rows count corners where four squares meet, "
            "one fewer than squares each way"
        )
        if not found or (shown[0] >= board_size[0] and shown[1] >= board_size[1]):
            raise RequestRefused("refused.board.counts", why)
        out.print(why, style="yellow", highlight=False, soft_wrap=True)
    if (board.columns + board.rows) % 2 == 0:
        out.print(
            f"a board of {board.columns}x{board.rows} corners looks the same half a turn on: its upper edge "
            "must be up in every picture; one of 9x6 may be held anyhow",
            style="yellow", highlight=False, soft_wrap=True,
        )  # fmt: skip


_LEAST_POINTS = 60
_ROWS_PX, _SPREAD_PX, _CELL_PX = 1.0, 0.8, 1.0  # [D] half of what odometry takes, the worst called rectified
_OFFSET_PX = 3.5  # [S] the worst that users reported of rectified cameras
_EDGE_PX = 2.0  # [D] three times a sharp picture's
_WHITE, _DARK, _BRIGHT = 0.05, 30.0, 225.0  # [D]
_JITTER = 0.25  # [D] of the median interval
_CALIBRATE = "calibrate it: longreach camera calibrate"


class CameraFinding(NamedTuple):
    """One thing that was looked at: what came, what is wanted, whether it is so, and what to do if not."""

    what: str
    found: str
    wanted: str
    good: bool
    advice: str = ""


def run_check(
    source: str, config: VisionConfig, most: int, board: Board | None, json_file: Path | None
) -> bool:
    """Print every finding. Returns whether all are good. Raises LongreachError where nothing can be looked
    at.
    """
    camera = config.camera
    taken = take(source, camera.model_copy(update={"calibration": PLAIN}), most)
    size = (camera.width_px, camera.height_px)
    for pair in taken.pairs:
        for picture in (pair.left, pair.right):
            refuse_size(
                picture, size, f"{source}: set vision.camera.width_px and height_px, or the camera's mode"
            )
    known = camera.calibration
    rectify = Rectifier(known) if isinstance(known, StereoCalibration) else None
    rectified = [rectify(pair) for pair in taken.pairs] if rectify else taken.pairs
    views = [] if board is None else boards_in(taken._replace(pairs=rectified), board)[0]
    if board is not None and not views:
        question([pair.left for pair in rectified], board, 0)
    rows = pair_check.rows_of(
        [PointPairs(view.left, view.right) for view in views]
        or [pair_check.matched(pair) for pair in rectified],
        size,
    )
    found = [
        CameraFinding("picture size an eye", f"{size[0]}x{size[1]} px", f"{size[0]}x{size[1]} px", True),
        *stamps(taken),
        *row_findings(rows, rectify is not None),
        *offset_findings(offset_of(rectified, config, views)),
        *(
            f
            for eye, k in (("left", 0), ("right", 1))
            for f in picture_findings(eye, [p[k] for p in taken.pairs])
        ),
    ]
    how = f"rectified by {known.source}" if isinstance(known, StereoCalibration) else "taken for rectified"
    good = _show(f"{source}: {len(taken.pairs)} pairs, {how}", found, rows)
    findings = [f._asdict() for f in found]
    write_json(json_file, {"good": good, "findings": findings, "rows": rows._asdict() if rows else None})
    return good


def _show(title: str, found: Sequence[CameraFinding], rows: RowReport | None) -> bool:
    """Whether all is good; each finding is printed, and the rows by place."""
    cells = [
        [f.what, f.found, f.wanted, "good" if f.good else "BAD", "" if f.good else f.advice] for f in found
    ]
    out.print(table(title, ("what", "found", "wanted", "verdict", "what to do"), cells))
    if rows is not None:
        places = [[f"{px:+.2f}" if np.isfinite(px) else "–" for px in row] for row in rows.cells_px]
        out.print(table("rows of the right eye below the left's, px, by place in the picture",
                        ("left", "", "", "right"), places))  # fmt: skip
    bad = ", ".join(f.what for f in found if not f.good)
    verdict, style = (f"BAD: {bad}", "bold red") if bad else ("good", "green")
    out.print(f"verdict: {verdict}", style=style, highlight=False)
    return not bad


PLAIN = PinholePair.model_validate(
    {eye: {"fx_px": 500.0, "fy_px": 500.0, "cx_px": 0.0, "cy_px": 0.0} for eye in ("left", "right")}
    | {"baseline_m": 0.1}
)
"""Stands for "no rectification" while pairs are taken; no number of it is used."""


def stamps(taken: Taken) -> list[CameraFinding]:
    """Rate, order and evenness of the capture times, where there are any."""
    if not taken.stamped or len(taken.pairs) < 3:
        return [CameraFinding("stamps", "none", "of a live camera or a recording", True)]
    steps = np.diff([pair.capture_ns for pair in taken.pairs]) * 1e-9
    if (steps <= 0.0).any():
        count = int((steps <= 0.0).sum())
        return [CameraFinding("stamps", f"{count} not after the one before", "ascending", False,
                        "stamps run backwards: another clock, or pictures out of order")]  # fmt: skip
    median = float(np.median(steps))
    jitter = float(np.median(np.abs(steps - median))) * 1.4826 / median
    gaps = int((steps > 1.8 * median).sum())
    return [
        CameraFinding("pairs a second", f"{1.0 / median:.1f}", "as configured", True),
        CameraFinding("jitter of the stamps", f"{100 * jitter:.0f} % of an interval, {gaps} gaps",
                f"at most {100 * _JITTER:.0f} %", jitter <= _JITTER,
                "stamped late by a busy host: fewer pictures a second, or stamps of the camera"),
    ]  # fmt: skip


def row_findings(rows: RowReport | None, raw: bool) -> list[CameraFinding]:
    """Whether the rows belong together."""
    count = 0 if rows is None else rows.points
    if rows is None or count < _LEAST_POINTS:
        return [CameraFinding("matched points", str(count), f"at least {_LEAST_POINTS}", False,
                        "show both eyes something with texture, in focus and light")]  # fmt: skip
    worst = (
        float(np.nanmax(np.abs(rows.cells_px - rows.median_px))) if np.isfinite(rows.cells_px).any() else 0.0
    )
    again = (
        f"the file does not fit this camera: {_CALIBRATE}"
        if raw
        else f"these pairs are not rectified: {_CALIBRATE}"
    )
    return [
        CameraFinding("eyes", f"median disparity {rows.disparity_px:+.1f} px", "above 0",
                rows.disparity_px > 0.0,
                "left and right are exchanged"),
        CameraFinding("rows off, median", f"{rows.median_px:+.2f} px of {count} points",
                f"within {_ROWS_PX:g} px",
                abs(rows.median_px) <= _ROWS_PX, again),
        CameraFinding("rows off, spread", f"{rows.spread_px:.2f} px", f"at most {_SPREAD_PX:g} px",
                rows.spread_px <= _SPREAD_PX, again),
        CameraFinding("rows off, by place", f"{worst:.2f} px from the median", f"at most {_CELL_PX:g} px",
                worst <= _CELL_PX, again),
    ]  # fmt: skip


def offset_of(
    pairs: Sequence[StereoPair], config: VisionConfig, views: Sequence[PairView]
) -> StereoOffset | None:
    """The right eye's offset by a board's squares, else by the configured markers; None where neither is
    seen.
    """
    camera = intrinsics.calibration(config.camera)
    if views:
        return board_offset(views, camera)
    seen: FrameObservation | None = None
    markers = 0
    for pair in pairs:
        seen = look.observe(pair, camera, config.markers, seen)
        markers += len(seen.markers)
    return None if seen is None or not markers else seen.offset


def offset_findings(offset: StereoOffset | None) -> list[CameraFinding]:
    """Whether ranges can be believed."""
    if offset is None:
        return [
            CameraFinding(
                "disparity offset", "no marker or board seen", "a known marker or board in view", True
            )
        ]
    shown = (
        f"{offset.x_px:+.2f} ± {offset.std_x_px:.2f} px across, "
        f"{offset.y_px:+.2f} ± {offset.std_y_px:.2f} down"
    )
    good = abs(offset.x_px) <= _OFFSET_PX
    return [CameraFinding("disparity offset", shown, f"within {_OFFSET_PX:g} px", good,
                    f"ranges are wrong: {_CALIBRATE}, or another size is printed")]  # fmt: skip


def picture_findings(eye: str, pictures: Sequence[Any]) -> list[CameraFinding]:
    """Exposure and sharpness of one eye, the median over the pictures."""
    reports = np.array([pair_check.picture_report(picture) for picture in pictures])
    of = PictureReport(*(float(np.nanmedian(column)) if np.isfinite(column).any() else float("nan")
                         for column in reports.T))  # fmt: skip
    lit = _DARK <= of.mean_grey <= _BRIGHT and of.white_share <= _WHITE
    sharp = not of.edge_px > _EDGE_PX
    edges = "no edge to measure" if np.isnan(of.edge_px) else f"edges {of.edge_px:.2f} px wide"
    return [
        CameraFinding(f"{eye} exposure",
                f"mean {of.mean_grey:.0f}, {of.white_share:.1%} white, {of.black_share:.1%} black",
                f"mean {_DARK:g} to {_BRIGHT:g}, at most {_WHITE:.0%} white", lit,
                "set vision.camera.uvc.exposure_us and gain, or more light"),
        CameraFinding(f"{eye} sharpness", edges, f"at most {_EDGE_PX:g} px", sharp,
                "clean and focus the lens, expose for a shorter time"),
    ]  # fmt: skip
