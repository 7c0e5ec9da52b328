"""`longreach markers` and `longreach odometry`: perception of pictures, without rig or controller."""

import time
from pathlib import Path
from typing import get_args

import numpy as np

from foundation.foreign_text import read_each
from protocol.errors import ConfigurationError, RequestRefused
from testbed.cli.options import OdometryOptions
from testbed.hand_eye.trajectories import Trajectory, load_tum
from testbed.reporting.console import bars, noted, out, promised, table, write_json
from testbed.reporting.trajectory_errors import errors_of_maps
from vision_pc.application.annotate import png
from vision_pc.config.vision import MarkerSettings, VisionConfig
from vision_pc.core.perception.picture_markers import PictureMarker, drawn, search
from vision_pc.core.perception.unread_markers import other_reading
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image
from vision_pc.shell.cameras.grey_files import read_grey
from vision_pc.shell.cameras.picture_files import matched_pictures, pictures_of
from vision_pc.shell.cameras.sequence import (
    PairRecord,
    Recorded,
    SequenceResult,
    follow,
    write_side_file,
    write_tum,
)

_ROWS_APART_PX = 2.0  # [D] of a rectified pair


def run_odometry(
    known: Recorded, config: VisionConfig, options: OdometryOptions, json_file: Path | None
) -> bool:
    """Whether every pair was located in one map. The path is in ``trajectory`` in TUM's form, pairs lost left
    out; beside it ``.csv`` has a line a pair, and each map apart has a trajectory of its own.
    """
    times_s = 1e-9 * np.array(known.files().times_ns)
    truth_file = options.truth
    truth = None if truth_file is None else _read_trajectory(truth_file, times_s)
    with bars() as shown, shown.step("following the camera") as bar:

        def report(record: PairRecord) -> None:
            state = "lost" if record.pose is None else f"{record.pose.inliers} points"
            place = f"pair {record.frame_id + 1} of {len(times_s)}"
            bar.update((record.frame_id + 1) / len(times_s), f"{place}: {state}")

        began_s = time.process_time()
        result = follow(known, config, report)
        spent_ms = 1e3 * (time.process_time() - began_s) / len(result.records)
    files = _write_trajectories(options.trajectory, result)
    _print(result, spent_ms, files)
    results: dict[str, object] = {
        "notes": result.notes, "pairs": len(result.records), "lost": result.lost,
        "losses": dict(result.losses), "maps": len(result.joints), "maps_apart": len(result.apart),
        "keyframes": result.keyframes, "offset": None if result.offset is None else result.offset._asdict(),
        "milliseconds_a_pair": spent_ms, "trajectories": list(map(str, files)),
    }  # fmt: skip
    try:
        if truth is not None:
            maps = {k: result.poses_of(k) for k in (0, *result.apart)}
            errors = errors_of_maps(maps, *truth, str(truth_file))
            for k, found in errors.items():
                which = f"map {k}, " if len(errors) > 1 else ""
                judged = found or "fewer than three poses: not judged"
                out.print(f"against the truth, {which}{judged}")
            results["truth"] = [{"map": k, "errors": e and e._asdict()} for k, e in errors.items()]
    finally:  # the path was found, whether the truth fits it or not
        write_json(json_file, results)
    return result.lost == 0 and not result.apart


def _read_trajectory(path: Path, times_s: Array) -> Trajectory:
    """As ``load_tum``. Raises ConfigurationError (``configuration.bad_trajectory``)."""
    try:
        return load_tum(path, times_s=times_s)
    except RequestRefused as refused:
        raise ConfigurationError("configuration.bad_trajectory", str(refused)) from refused


def _write_trajectories(trajectory: Path, result: SequenceResult) -> list[Path]:
    """The files of all trajectories: that of the first map, then one for each that is apart."""
    write_side_file(promised(trajectory.with_suffix(".csv")), result)
    apart = [trajectory.with_name(f"{trajectory.stem}.map{k}{trajectory.suffix}") for k in result.apart]
    for path, k in zip((trajectory, *apart), (0, *result.apart), strict=True):
        write_tum(path, result.poses_of(k))
    return [trajectory, *apart]


def _print(result: SequenceResult, spent_ms: float, files: list[Path]) -> None:
    causes = ", ".join(f"{cause} {count}" for cause, count in result.losses.most_common())
    lost = f"{result.lost} lost ({causes})" if result.lost else "none lost"
    lines = [
        *result.notes,
        f"{len(result.records)} pairs, {lost}; {result.keyframes} keyframes; {spent_ms:.1f} ms a pair;"
        f" {files[0]} holds {len(result.poses)} poses",
    ]
    if result.offset is not None:
        off = f"{result.offset.px:+.2f} px off, known to {result.offset.std_px:.2f} px"
        lines.append(f"all disparities are {off} from the way itself; taken out")
    for path, k in zip(files[1:], result.apart, strict=True):
        first = next(record for record in result.records if record.segment == k)
        lines.append(
            f"map {k} begins at pair {first.frame_id + 1} after a gap of unknown length and was never joined:"
            f" {len(result.poses_of(k))} poses from its own first pair are in {path}"
        )
    for line in lines:
        out.print(line, highlight=False, soft_wrap=True)


_HEADS = ("picture", "number", "side px", "x px", "y px", "corners by", "sigma px")
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
    requested = frozenset(numbers)
    pictures, right, unpaired = _given(pictures, right)
    rows: list[tuple[str, ...]] = []
    results: list[dict[str, object]] = []
    readable, notes = _checked(pictures, right, dictionary)
    complete = not notes
    notes += unpaired
    for (path, twin), (image, twin_image) in readable:
        found = _detect_in_picture(path, image, dictionary, requested, directory, notes)
        other = _detect_in_picture(twin, twin_image, dictionary, requested, directory, notes) if right else []
        missing = sorted(requested - {marker.number for marker in found})
        wrong = _questions(found, other) if right else ""
        complete &= bool(found) and not missing and not wrong
        notes += [f"{path.name}, {twin.name}: {wrong}"] if wrong else []
        rows += [_row(path, marker) for marker in found]
        rows += [(path.name, str(number), *["-"] * 5) for number in missing]
        results.append({"picture": str(path), "markers": _plain(found), "missing": missing})
        if right:
            results[-1] |= {"right_picture": str(twin), "right_markers": _plain(other)}
    out.print(table("markers", _HEADS, rows))
    noted(notes)
    out.print(f"{len(rows)} lines from {len(readable)} pictures; {'complete' if complete else 'INCOMPLETE'}")
    answer = {"dictionary": dictionary, "pictures": results, "notes": notes, "complete": complete}
    write_json(json_file, answer)
    return complete


def _given(pictures: list[Path], right: list[Path]) -> tuple[list[Path], list[Path], list[str]]:
    """The pictures of either eye, pairs in the same order, and what has no partner: directories are paired by
    the names in them, as a sequence is. Raises ConfigurationError.
    """
    lefts, rights = pictures_of(pictures), pictures_of(right)
    if not any(path.is_dir() for path in right):
        return lefts, rights, []
    chosen, notes = matched_pictures(lefts, rights)
    return [lefts[i] for i, _ in chosen], [rights[j] for _, j in chosen], notes


def _checked(
    pictures: list[Path], right: list[Path], dictionary: str
) -> tuple[list[tuple[tuple[Path, Path], tuple[Image, Image]]], list[str]]:
    """The pairs, or each picture twice, that can be searched, and why others cannot. Raises as
    ``run_markers``.
    """
    if dictionary not in _DICTIONARIES:
        raise ConfigurationError(
            "configuration.unknown_dictionary", f"{dictionary}: one of {', '.join(_DICTIONARIES)} is wanted"
        )
    if right and len(right) != len(pictures):
        raise ConfigurationError(
            "configuration.bad_pairs", f"{len(pictures)} left pictures, but {len(right)} right ones"
        )
    if right and any(one.resolve() == other.resolve() for one, other in zip(pictures, right, strict=True)):
        raise ConfigurationError("configuration.bad_pairs", "a picture is given as its own right one")
    both = zip(pictures, right or pictures, strict=True)
    return read_each(both, lambda pair: (read_grey(pair[0]), read_grey(pair[1])))


def _detect_in_picture(
    path: Path,
    image: Image,
    dictionary: str,
    requested: frozenset[int],
    directory: Path | None,
    notes: list[str],
) -> list[PictureMarker]:
    """The markers of the picture at ``path``, also drawn into ``directory``; ``notes`` gets why others are
    not among them.
    """
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
    if (other := other_reading(image, dictionary, _DICTIONARIES)) is None:
        return reason
    how = f" if {other.how}" if other.how else ""
    return f"{reason}: as {other.dictionary}{how} they read {' '.join(map(str, other.numbers))}"


def _questions(left: list[PictureMarker], right: list[PictureMarker]) -> str:
    """What the markers that both pictures show say against a rectified pair; empty where nothing does."""
    there = {one.number: one.corners.mean(axis=0) for one in right}
    apart = [one.corners.mean(axis=0) - there[one.number] for one in left if one.number in there]
    if not apart:
        return "no marker is in both"
    disparity, rows = np.median(apart, axis=0)
    if disparity <= 0.0:
        return f"disparity is {disparity:.1f} px, not above 0: the eyes are exchanged, or it is one picture"
    if abs(rows) > _ROWS_APART_PX:
        return f"rows are {rows:+.1f} px apart, limit {_ROWS_APART_PX:g} px: no rectified pair"
    return ""


def _row(path: Path, marker: PictureMarker) -> tuple[str, ...]:
    x, y = marker.corners.mean(axis=0)
    shown = f"{marker.number}", f"{marker.side_px:.1f}", f"{x:.2f}", f"{y:.2f}"
    return path.name, *shown, marker.method, f"{marker.std_px:.2f}"


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
