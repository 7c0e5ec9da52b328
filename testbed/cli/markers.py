"""`longreach markers`: what is seen in pictures, without rig or controller."""

from pathlib import Path
from typing import get_args

import cv2
import numpy as np

from protocol.errors import ConfigurationError
from testbed.reporting.console import out, table, write_json
from vision_pc.config.vision import MarkerSettings
from vision_pc.core.perception.picture_markers import PictureMarker, drawn, found_markers
from vision_pc.shell.cameras.directory import read_grey

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
    wanted = frozenset(numbers)
    rows: list[tuple[str, ...]] = []
    figures: list[dict[str, object]] = []
    complete = True
    for k, path in enumerate(pictures):
        found = _seen(path, dictionary, wanted, directory)
        other = _seen(right[k], dictionary, wanted, directory) if right else []
        missing = sorted(wanted - {marker.number for marker in found})
        complete &= bool(found) and not missing
        rows += [_row(path, marker, other) for marker in found]
        rows += [(path.name, str(number), *["-"] * 6) for number in missing]
        figures.append({"picture": str(path), "markers": _plain(found), "missing": missing})
        if right:
            figures[-1] |= {"right_picture": str(right[k]), "right_markers": _plain(other)}
    heads = ("picture", "number", "side px", "x px", "y px", "corners by", "sigma px", "disparity, rows px")
    out.print(table("markers", heads if right else heads[:-1], [row[: 8 if right else 7] for row in rows]))
    out.print(f"{len(rows)} lines from {len(pictures)} pictures; {'complete' if complete else 'INCOMPLETE'}")
    write_json(json_file, {"dictionary": dictionary, "pictures": figures, "complete": complete})
    return complete


def _seen(path: Path, dictionary: str, wanted: frozenset[int], directory: Path | None) -> list[PictureMarker]:
    """The markers of the picture at ``path``, also drawn into ``directory``."""
    image = read_grey(path)
    found = found_markers(image, dictionary, wanted)
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(directory / f"{path.parent.name}_{path.stem}_markers.png"), drawn(image, found))
    return found


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
