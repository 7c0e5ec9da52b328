"""`longreach markers` and `longreach odometry`: perception of pictures, without rig or controller."""

import time
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np

from foundation.configuration import load, parse_overrides
from protocol.errors import ConfigurationError
from testbed.cli.options import OdometryOptions
from testbed.reporting.console import bars, out, promised, table, write_json
from testbed.reporting.trajectory_errors import TrajectoryErrors, errors_of_maps, read_tum
from vision_pc.application.annotate import png
from vision_pc.config.vision import MarkerSettings, VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception.picture_markers import PictureMarker, drawn, search
from vision_pc.core.perception.unread_markers import other_reading
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image, StereoPair
from vision_pc.shell.cameras.directory import read_grey
from vision_pc.shell.cameras.sequence import (
    PairRecord,
    Recorded,
    SequenceResult,
    follow,
    write_side_file,
    write_tum,
)

_SAME_S = 1e-4
_GAP_S = 0.3  # the rig's own limit between two states


class OdometryRequest(NamedTuple):
    """Two directories of pictures, their calibration, where the path goes, and the truth if it is known."""

    config_dir: Path
    left: Path
    right: Path
    calibration: Path
    options: OdometryOptions
    settings: list[str]


def run_odometry(request: OdometryRequest, json_file: Path | None) -> bool:
    """Whether every pair was located in one map. The path is in ``trajectory`` in TUM's form, pairs lost left
    out; beside it ``.csv`` has a line a pair, and each map apart has a trajectory of its own.
    """
    overrides = parse_overrides(request.settings).get("vision")
    config = load(VisionConfig, request.config_dir / "vision.yaml", overrides)
    truth = None if request.options.truth is None else read_tum(request.options.truth)
    tool_at = ToolPoses(request.options.tool_poses)
    known = Recorded(request.left, request.right, request.calibration, request.options.rate_hz, tool_at)
    count = len(known.files().files)
    with bars() as shown, shown.step("following the camera") as bar:

        def report(record: PairRecord) -> None:
            held = "lost" if record.pose is None else f"{record.pose.inliers} points"
            bar.update((record.frame_id + 1) / count, f"pair {record.frame_id + 1} of {count}: {held}")

        began = time.process_time()
        result = follow(known, config, report)
        spent_ms = 1e3 * (time.process_time() - began) / len(result.records)
    tool_at.require()
    files = _write_trajectories(request.options.trajectory, result)
    _print(result, spent_ms, files)
    figures = _figures(result) | {
        "milliseconds_a_pair": spent_ms,
        "pairs_with_tool_pose": len(tool_at.used),
        "trajectories": [str(path) for path in files],
    }
    try:
        if truth is not None:
            maps = {k: result.poses_of(k) for k in (0, *result.apart)}
            errors = errors_of_maps(maps, *truth, str(request.options.truth))
            _print_errors(errors)
            figures["truth"] = [{"map": k, "errors": e and e._asdict()} for k, e in errors.items()]
    finally:  # the path was found, whether the truth fits it or not
        write_json(json_file, figures)
    return result.lost == 0 and not result.apart


def _figures(result: SequenceResult) -> dict[str, object]:
    return {
        "notes": result.notes,
        "pairs": len(result.records),
        "lost": result.lost,
        "losses": dict(result.losses),
        "maps": len(result.joints),
        "maps_apart": len(result.apart),
        "keyframes": result.keyframes,
        "offset": None if result.offset is None else result.offset._asdict(),
    }


class ToolPoses:
    """Where the tool was at a pair's capture, by a file of poses, if there is one. Raises ConfigurationError.

    ``used``: the pairs that it had a pose for.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._times_s, self._poses = (np.zeros(0), np.zeros((0, 4, 4))) if path is None else read_tum(path)
        self.used: set[int] = set()

    def __call__(self, pair: StereoPair) -> Array | None:
        """X_BT between two poses that are no further apart than states may be; None where there are none."""
        found = self._between(pair.capture_ns / 1e9)
        if found is not None:
            self.used.add(pair.frame_id)
        return found

    def _between(self, at_s: float) -> Array | None:
        times_s, poses = self._times_s, self._poses
        newer = int(np.searchsorted(times_s, at_s - _SAME_S))
        if newer < len(times_s) and times_s[newer] - at_s <= _SAME_S:
            return np.asarray(poses[newer])
        if newer in (0, len(times_s)) or times_s[newer] - times_s[newer - 1] > _GAP_S:
            return None
        fraction = (at_s - times_s[newer - 1]) / (times_s[newer] - times_s[newer - 1])
        return se3.interpolate(poses[newer - 1], poses[newer], float(fraction))

    def require(self) -> None:
        """Raise ConfigurationError when no pair had a pose."""
        if self._path is not None and not self.used:
            told = f"{self._times_s[0]:.3f} to {self._times_s[-1]:.3f} s"
            why = f"{self._path}: {told}, and no pair was taken then: the clocks do not overlap"
            raise ConfigurationError("configuration.bad_trajectory", why)


def _write_trajectories(trajectory: Path, result: SequenceResult) -> list[Path]:
    """The files of all trajectories: that of the first map, then one for each that is apart."""
    write_side_file(promised(trajectory.with_suffix(".csv")), result)
    files = [trajectory] + [
        trajectory.with_name(f"{trajectory.stem}.map{k}{trajectory.suffix}") for k in result.apart
    ]
    for path, k in zip(files, [0, *result.apart], strict=True):
        write_tum(path, result.poses_of(k))
    return files


def _print(result: SequenceResult, spent_ms: float, files: list[Path]) -> None:
    for note in result.notes:
        out.print(note, highlight=False, soft_wrap=True)
    causes = ", ".join(f"{cause} {count}" for cause, count in result.losses.most_common())
    lost = f"{result.lost} lost ({causes})" if result.lost else "none lost"
    out.print(
        f"{len(result.records)} pairs, {lost}; {result.keyframes} keyframes; {spent_ms:.1f} ms a pair;"
        f" {files[0]} holds {len(result.poses)} poses"
    )
    if result.offset is not None:
        out.print(
            f"all disparities are {result.offset.px:+.2f} px off, known to {result.offset.std_px:.2f} px from"
            " the way itself; taken out"
        )
    for path, k in zip(files[1:], result.apart, strict=True):
        first = next(record for record in result.records if record.segment == k)
        out.print(
            f"map {k} begins at pair {first.frame_id + 1} after a gap of unknown length and was never joined:"
            f" {len(result.poses_of(k))} poses from its own first pair are in {path}"
        )


def _print_errors(maps: dict[int, TrajectoryErrors | None]) -> None:
    for k, errors in maps.items():
        which = f"map {k}, " if len(maps) > 1 else ""
        if errors is None:
            out.print(f"against the truth, {which}fewer than three poses: not judged")
            continue
        drift = "" if errors.drift_percent is None else f", drift {errors.drift_percent:.2f} %"
        out.print(
            f"against the truth, {which}{errors.poses} poses over {errors.length_m:.2f} m: ATE"
            f" {errors.ate_mm:.2f} mm, RPE {errors.rpe_mm:.2f} mm {errors.rpe_deg:.4f} deg a pair, scale"
            f" {errors.scale:.4f}{drift}"
        )


_DICTIONARIES = get_args(MarkerSettings.model_fields["dictionary"].annotation)


def run_markers(
    pictures: list[Path],
    right: list[Path],
    dictionary: str,
    numbers: list[int],
    directory: Path | None,
    json_file: Path | None,
) -> bool:
    """Whether each picture showed every wanted number, or any marker where none is wanted.

    Raises ConfigurationError for an unknown dictionary, unreadable pictures and pairs that are none.
    """
    if dictionary not in _DICTIONARIES:
        raise ConfigurationError(
            "configuration.unknown_dictionary", f"{dictionary}: one of {', '.join(_DICTIONARIES)} is wanted"
        )
    if right and len(right) != len(pictures):
        raise ConfigurationError(
            "configuration.bad_pairs", f"{len(pictures)} left pictures, but {len(right)} right ones"
        )
    requested = frozenset(numbers)
    rows: list[tuple[str, ...]] = []
    figures: list[dict[str, object]] = []
    complete = True
    notes: list[str] = []
    for k, path in enumerate(pictures):
        found = _detect_in_picture(path, dictionary, requested, directory, notes)
        other = _detect_in_picture(right[k], dictionary, requested, directory, notes) if right else []
        missing = sorted(requested - {marker.number for marker in found})
        complete &= bool(found) and not missing
        rows += [_row(path, marker, other) for marker in found]
        rows += [(path.name, str(number), *["-"] * 6) for number in missing]
        figures.append({"picture": str(path), "markers": _plain(found), "missing": missing})
        if right:
            figures[-1] |= {"right_picture": str(right[k]), "right_markers": _plain(other)}
    heads = ("picture", "number", "side px", "x px", "y px", "corners by", "sigma px", "disparity, rows px")
    out.print(table("markers", heads if right else heads[:-1], [row[: 8 if right else 7] for row in rows]))
    for note in notes:
        out.print(note, style="yellow", highlight=False, soft_wrap=True)
    out.print(f"{len(rows)} lines from {len(pictures)} pictures; {'complete' if complete else 'INCOMPLETE'}")
    write_json(
        json_file, {"dictionary": dictionary, "pictures": figures, "notes": notes, "complete": complete}
    )
    return complete


def _detect_in_picture(
    path: Path, dictionary: str, requested: frozenset[int], directory: Path | None, notes: list[str]
) -> list[PictureMarker]:
    """The markers of the picture at ``path``, also drawn into ``directory``; ``notes`` gets why others are
    not among them.
    """
    image = read_grey(path)
    found = search(image, dictionary, requested)
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True)
        to = directory / f"{path.parent.name}_{path.stem}_markers.png"
        to.write_bytes(png(drawn(image, found.markers)))
    if found.edgeless:
        which = " ".join(map(str, found.edgeless))
        notes.append(f"{path.name}: left out, as no edge of ink and paper is at their corners: {which}")
    if not found.markers:
        notes.append(f"{path.name}: {_unread(image, dictionary, found.squares)}")
    return found.markers


def _unread(image: Image, dictionary: str, squares: int) -> str:
    """What the picture shows in place of markers of ``dictionary``."""
    reason = f"no marker of {dictionary} was read; {squares} squares look like markers"
    other = other_reading(image, dictionary, _DICTIONARIES)
    if other is None:
        return reason
    numbers = " ".join(map(str, other.numbers))
    how = f" if {other.how}" if other.how else ""
    return f"{reason}: as {other.dictionary}{how} they read {numbers}"


def _row(path: Path, marker: PictureMarker, other: list[PictureMarker]) -> tuple[str, ...]:
    x, y = marker.corners.mean(axis=0)
    twins = [one for one in other if one.number == marker.number]
    apart = "-"
    if len(twins) == 1:
        dx, dy = (marker.corners - twins[0].corners).mean(axis=0)
        apart = f"{dx:.2f}, {-dy:+.2f}"
    return (
        path.name,
        str(marker.number),
        f"{marker.side_px:.1f}",
        f"{x:.2f}",
        f"{y:.2f}",
        marker.method,
        f"{marker.std_px:.2f}",
        apart,
    )


def _plain(markers: list[PictureMarker]) -> list[dict[str, object]]:
    return [
        {
            "number": marker.number,
            "corners_px": np.round(marker.corners, 4).tolist(),
            "side_px": round(marker.side_px, 3),
            "refined_by": marker.method,
            "std_px": marker.std_px,
        }
        for marker in markers
    ]
