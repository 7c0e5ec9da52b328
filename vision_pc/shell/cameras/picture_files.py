"""Pictures in directories: their order, which picture of the right eye belongs to which of the left, and when
they were taken. Every command that reads pictures goes this way.
"""

import bisect
import re
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from foundation.foreign_text import read_text, unreadable
from foundation.numbers_as_written import written_number
from protocol.errors import ConfigurationError
from vision_pc.shell.cameras.capture_times import order_of_name, times_of, times_of_names

_PICTURES = (".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".bmp", ".tif", ".tiff", ".webp", ".jp2")
_SHOWN = 3  # names in a note


class EyeFiles(NamedTuple):
    """Pictures of both eyes, (left, right) in order of time, with their ``times_ns``; ``notes`` says what the
    times are and what was left out.
    """

    files: list[tuple[Path, Path]]
    times_ns: list[int]
    notes: tuple[str, ...]


def pictures_in(directory: Path) -> list[Path]:
    """The pictures of a directory in the order of the numbers in their names.

    Raises ConfigurationError where there are none.
    """
    if not directory.is_dir():
        raise ConfigurationError("configuration.bad_sequence", f"{directory}: no such directory")
    found = [
        path
        for path in directory.iterdir()
        if path.suffix.lower() in _PICTURES and not path.name.startswith("._")  # what macOS puts beside files
    ]
    if not found:
        why = f"{directory}: 0 pictures, at least 1 is wanted: {' '.join(_PICTURES)}"
        raise ConfigurationError("configuration.bad_sequence", why)
    return sorted(found, key=order_of_name)


def pictures_of(paths: Sequence[Path]) -> list[Path]:
    """The files among ``paths``, each directory's pictures in its place. Raises ConfigurationError as
    ``pictures_in``.
    """
    return [file for path in paths for file in (pictures_in(path) if path.is_dir() else [path])]


def eye_files(left: Path, right: Path, rate_hz: float) -> EyeFiles:
    """The pairs of two directories and their times.

    Pictures whose names are times belong together where they are less than half a period apart; others where
    names are equal, or, where no two names are, in their order. Times come from ``times.txt`` beside or above
    ``left``, from the names, or else from ``rate_hz``. Raises ConfigurationError.
    """
    lefts, rights = pictures_in(left), pictures_in(right)
    chosen, notes = matched_pictures(lefts, rights)
    times, source = _times(left, lefts, rate_hz)
    files = [(lefts[i], rights[j]) for i, j in chosen]
    return EyeFiles(files, [times[i] for i, _ in chosen], (source, *notes))


def matched_pictures(lefts: list[Path], rights: list[Path]) -> tuple[list[tuple[int, int]], list[str]]:
    """Indices (left, right) of the pictures that belong together, as ``eye_files`` says, and what was left
    out, in words. Raises ConfigurationError where nothing tells which do.
    """
    if not {path.resolve() for path in lefts}.isdisjoint(path.resolve() for path in rights):
        why = f"{lefts[0].parent}: one folder for both eyes: a picture would be paired with itself"
        raise ConfigurationError("configuration.bad_sequence", why)
    stamps = times_of_names(lefts), times_of_names(rights)
    if stamps[0] is not None and stamps[1] is not None:
        return _by_times(lefts, rights, stamps[0].times_ns, stamps[1].times_ns)
    return _by_names(lefts, rights)


def _by_times(
    lefts: list[Path], rights: list[Path], left_ns: list[int], right_ns: list[int]
) -> tuple[list[tuple[int, int]], list[str]]:
    """Indices of pictures nearest to each other in time. Raises ConfigurationError where none are."""
    half_ns = 0.5 * min(_period_ns(left_ns), _period_ns(right_ns))
    nearest = [_nearest(at, right_ns) for at in left_ns]
    back = [_nearest(at, left_ns) for at in right_ns]
    apart = [abs(at - right_ns[j]) for at, j in zip(left_ns, nearest, strict=True)]
    chosen = [(i, j) for i, j in enumerate(nearest) if back[j] == i and (apart[i] < half_ns or apart[i] == 0)]
    if not chosen:
        why = (
            f"{lefts[0].parent} and {rights[0].parent}: no picture of one eye is within half a period "
            f"({1e-6 * half_ns:.0f} ms) of one of the other; by their names the nearest are "
            f"{1e-6 * min(apart):.0f} ms apart: was one clock set otherwise?"
        )
        raise ConfigurationError("configuration.bad_sequence", why)
    notes = _left_out(lefts, rights, chosen)
    worst = max(apart[i] for i, _ in chosen)
    if worst:
        notes.append(f"pictures of a pair are up to {1e-6 * worst:.1f} ms apart by their names")
    return chosen, notes


def _period_ns(times_ns: Sequence[int]) -> float:
    steps = sorted(b - a for a, b in pairwise(times_ns))
    return float(steps[len(steps) // 2]) if steps else 0.0


def _nearest(at_ns: int, times_ns: Sequence[int]) -> int:
    """Index of the time (rising) nearest to ``at_ns``."""
    k = bisect.bisect_left(times_ns, at_ns)
    beside = [i for i in (k - 1, k) if 0 <= i < len(times_ns)]
    return min(beside, key=lambda i: abs(times_ns[i] - at_ns))


def _by_names(lefts: list[Path], rights: list[Path]) -> tuple[list[tuple[int, int]], list[str]]:
    """Indices of pictures with equal names, or equal numbers in their names, or of all in their order where
    no two are equal and all numbers differ by the same. Raises ConfigurationError for others.
    """
    numbers = _numbers(lefts), _numbers(rights)
    for keys in ([_without_eye(path.stem) for path in eye] for eye in (lefts, rights)), numbers:
        left_keys, right_keys = keys
        place = {key: j for j, key in enumerate(right_keys)}
        chosen = [(i, place[key]) for i, key in enumerate(left_keys) if key in place]
        if chosen and len(place) == len(rights) and len(set(left_keys)) == len(lefts):
            return chosen, _left_out(lefts, rights, chosen)
    steps = [
        [b - a for pair in pairwise(eye) for a, b in zip(*pair, strict=False)] for eye in numbers if any(eye)
    ]
    if len(lefts) != len(rights) or (len(steps) == 2 and steps[0] != steps[1]):
        counts = f"{lefts[0].parent}: {len(lefts)} pictures, but {len(rights)} in {rights[0].parent}"
        why = f"{counts}, and neither names nor numbers in them tell which belong together"
        raise ConfigurationError("configuration.bad_sequence", why)
    note = f"no two names are equal: {lefts[0].name} and {rights[0].name} are taken for the first pair"
    return [(k, k) for k in range(len(lefts))], [note]


def _without_eye(stem: str) -> str:
    """A name without the eye's, by which pictures of both eyes often differ."""
    plain = stem.lower()
    for eye in ("left", "right"):
        plain = plain.replace(eye, "")
    return plain


def _numbers(paths: list[Path]) -> list[tuple[int, ...]]:
    """The numbers in each name that are not the same in all of one eye (cam0_000, frame000_l1)."""
    found = [[int(word) for word in re.findall(r"[0-9]+", path.stem)] for path in paths]
    if len({len(words) for words in found}) > 1:
        return [tuple(words) for words in found]
    varying = [len(set(column)) > 1 or len(paths) == 1 for column in zip(*found, strict=True)]
    return [tuple(word for word, kept in zip(words, varying, strict=True) if kept) for words in found]


def _left_out(lefts: list[Path], rights: list[Path], chosen: list[tuple[int, int]]) -> list[str]:
    used = {i for i, _ in chosen}, {j for _, j in chosen}
    alone = [
        [p for k, p in enumerate(all_) if k not in of] for all_, of in zip((lefts, rights), used, strict=True)
    ]
    if not any(alone):
        return []
    shown = [path.name for path in (*alone[0], *alone[1])]
    names = ", ".join(shown[:_SHOWN]) + (", …" if len(shown) > _SHOWN else "")
    counts = f"{len(alone[0])} pictures of the left eye and {len(alone[1])} of the right one"
    return [f"left out, without a partner: {counts} ({names})"]


def _times(left: Path, lefts: list[Path], rate_hz: float) -> tuple[list[int], str]:
    """The time of each picture, ns, and where they come from."""
    for table in (left / "times.txt", left.parent / "times.txt"):
        if table.is_file():
            listed = times_of(_values(table))
            for line, (before, after) in enumerate(pairwise(listed.times_ns), 2):
                if after <= before:
                    why = f"{table}: time {line} is no later than the one above it: have they lost digits?"
                    raise ConfigurationError("configuration.bad_sequence", why)
            source = f"times: {listed.unit}, from {table}"
            if len(listed.times_ns) == len(lefts):
                return listed.times_ns, source
            lines = _lines_of_names(lefts, len(listed.times_ns))
            if lines is None:
                why = f"{table}: {len(listed.times_ns)} times for {len(lefts)} pictures"
                raise ConfigurationError("configuration.bad_sequence", why)
            source += f", by the numbers in the names: {len(listed.times_ns)} times, {len(lefts)} pictures"
            return [listed.times_ns[line] for line in lines], source
    stamps = times_of_names(lefts)
    if stamps is not None:
        return stamps.times_ns, f"times: {stamps.unit}, from the pictures' names"
    source = f"times: {rate_hz:g} pairs a second are taken, as names hold no time and there is no times.txt"
    return [round(index * 1e9 / rate_hz) for index in range(len(lefts))], source


def _lines_of_names(names: list[Path], count: int) -> list[int] | None:
    """Which of ``count`` lines each name's number is, from 0, or from 1 where only that fits; else None."""
    if not all(name.stem.isascii() and name.stem.isdigit() for name in names):
        return None
    numbers = [int(name.stem) for name in names]
    first = int(max(numbers) == count)
    known = len(set(numbers)) == len(names) and first <= min(numbers) and max(numbers) < count + first
    return [number - first for number in numbers] if known else None


def _values(table: Path) -> list[Decimal]:
    """The numbers of a list, one a line. Raises ConfigurationError that names the line."""
    values = []
    try:
        lines = read_text(table).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError("configuration.bad_sequence", f"{table}: {unreadable(error)}") from error
    for number, line in enumerate(lines, 1):
        content = line.partition("#")[0].strip()
        try:
            if content:
                written_number(content)
                values.append(Decimal(content.replace("\u2212", "-")))
        except ValueError as error:
            why = f"{table}: line {number} is {content[:40]!r}, one time a line is wanted"
            raise ConfigurationError("configuration.bad_sequence", why) from error
    return values
