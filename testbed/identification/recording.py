"""A recording of an arm's motion for identification: one CSV file that any controller can write.

Lines that begin with ``#`` are a YAML mapping about the whole (``About``); then a line of column names and
one line for each sample. A sample's sensors are those of its time; its valve words are in force from then
until the next sample. Joint order: slew, lift, tilt, wrist1, wrist2, wrist3.
"""

import csv
import hashlib
import io
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field

from foundation.configuration import StrictModel, parse_mapping, validated
from foundation.foreign_text import comma_separated, decoded
from plant_emulator.config.actuators import BAR
from plant_emulator.core.layout import JOINTS, N_ACTUATORS
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]

FIRST_LINE = "longreach recording 1"
_VALVES = [f"valve_{joint}" for joint in JOINTS]
_ANGLES = [f"angle_{joint}_rad" for joint in JOINTS]
_PRESSURES = [f"pressure_{joint}_{side}_bar" for joint in JOINTS for side in "ab"]
COLUMNS = ["time_s", *_VALVES, *_ANGLES, *_PRESSURES, "supply_bar", "oil_degc"]


class About(StrictModel):
    """What a recording is of. ``held_out_from_s``: from then on it is kept for validation, not for fitting.

    ``plant_hash`` is that of the emulator's configuration, None for a machine. ``rest_s``: how long the arm
    stands still at the beginning, valves shut; noise and the state to start from are taken there.
    """

    arm: str
    arm_hash: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    valve_set: str
    plant_hash: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")] | None = None
    rest_s: Annotated[float, Field(ge=0.2, le=60.0)]
    held_out_from_s: Annotated[float, Field(gt=0.0)]
    note: str = ""


class MotionRecording(NamedTuple):
    """``n`` samples in SI units; ``sha256`` is of the file as it stands on the disk, empty before that."""

    about: About
    time_s: Array  # (n,)
    valves: Array  # (n, 6) −1 to 1
    angles: Array  # (n, 6) rad, as the encoders tell
    pressures: Array  # (n, 6, 2) Pa, chambers a and b
    supply: Array  # (n,) Pa
    oil_degc: Array  # (n,)
    sha256: str = ""

    def part(self, first_s: float, last_s: float) -> "MotionRecording":
        """The samples of ``first_s`` ≤ time < ``last_s``."""
        inside = (self.time_s >= first_s - 1e-9) & (self.time_s < last_s - 1e-9)
        return self._replace(**{name: getattr(self, name)[inside] for name in _SERIES})

    @property
    def period_s(self) -> float:
        """The time from one sample to the next."""
        return float(np.median(np.diff(self.time_s)))


_SERIES = ("time_s", "valves", "angles", "pressures", "supply", "oil_degc")


def hex_hash(number: int) -> str:
    """A configuration's hash as a recording carries it."""
    return f"{number:016x}"


def write_recording(path: Path, recording: MotionRecording) -> MotionRecording:
    """Write ``recording`` to ``path``; what was written, with the hash of the file.

    Raises ConfigurationError when the file cannot be written.
    """
    n = len(recording.time_s)
    rows = np.column_stack(
        [
            recording.time_s,
            recording.valves,
            recording.angles,
            recording.pressures.reshape(n, 2 * N_ACTUATORS) / BAR,
            recording.supply / BAR,
            recording.oil_degc,
        ]
    )
    text = io.StringIO()
    about = yaml.safe_dump(recording.about.model_dump(), sort_keys=False)
    text.writelines(f"# {line}\n" for line in [FIRST_LINE, *about.splitlines()])
    text.write(",".join(COLUMNS) + "\n")
    np.savetxt(text, rows, fmt="%.9g", delimiter=",")
    data = text.getvalue().encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{path}: {error.strerror}") from error
    return recording._replace(sha256=hashlib.sha256(data).hexdigest())


def read_recording(path: Path) -> MotionRecording:
    """The recording in the file at ``path``; its samples are as ``checks.check_samples`` wants them or not.

    Raises ConfigurationError for a file that is no recording, lacks a column, or holds what is no number.
    """
    try:
        data = path.read_bytes()
        lines = [_without_empty_cells(line) for line in decoded(data).splitlines()]
    except OSError as error:
        raise ConfigurationError("recording.unreadable", f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            "recording.unreadable", f"{path}: not UTF-8 at byte {error.start}"
        ) from error
    header = [line.removeprefix("#").removeprefix(" ") for line in lines if line.startswith("#")]
    if not header or header[0].strip() != FIRST_LINE:
        raise ConfigurationError("recording.not_one", f"{path}: the first line is not '# {FIRST_LINE}'")
    about = _about("\n".join(header[1:]), path)
    body = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
    try:
        rows = comma_separated([line for _, line in body])
    except ValueError as error:
        raise ConfigurationError("recording.separators", f"{path}: {error}") from error
    body = [(number, line) for (number, _), line in zip(body, rows, strict=True)]
    names, order = _order(body[0][1] if body else "", path)
    table = np.array([_numbers(line, number, names, path) for number, line in body[1:]])
    table = table.reshape(len(table), len(names))[:, order]
    n = len(table)
    time_s, valves, angles, pressures, supply, oil = np.split(table, [1, 7, 13, 25, 26], axis=1)
    return MotionRecording(
        about,
        time_s[:, 0],
        valves,
        angles,
        pressures.reshape(n, N_ACTUATORS, 2) * BAR,
        supply[:, 0] * BAR,
        oil[:, 0],
        hashlib.sha256(data).hexdigest(),
    )


def _without_empty_cells(line: str) -> str:
    """A comment without the empty cells that a spreadsheet puts behind it; other lines as they are."""
    return line.strip('"').rstrip(',;\t" ') if line.lstrip('"').startswith("#") else line


def _about(text: str, path: Path) -> About:
    try:
        return validated(About, parse_mapping(text, str(path)), str(path))
    except ConfigurationError as error:
        if error.cause not in ("configuration.not_yaml", "configuration.not_a_mapping"):
            raise
        raise ConfigurationError("recording.not_one", str(error)) from error


def _order(line: str, path: Path) -> tuple[list[str], list[int]]:
    """The names of the file's columns, and where each of ``COLUMNS`` stands among them; more may be there."""
    names = [name.strip() for name in line.split(",")]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        pressures = [name for name in missing if name in (*_PRESSURES, "supply_bar")]
        cause = "recording.no_pressures" if pressures else "recording.missing_column"
        some = ", ".join((pressures or missing)[:3]) + (" …" if len(pressures or missing) > 3 else "")
        raise ConfigurationError(
            cause, f"{path}: {len(pressures or missing)} columns missing, such as {some}"
        )
    return names, [names.index(name) for name in COLUMNS]


def _numbers(line: str, number: int, names: list[str], path: Path) -> list[float]:
    cells = next(csv.reader([line]))
    if len(cells) != len(names):
        raise ConfigurationError(
            "recording.ragged", f"{path}: line {number} has {len(cells)} cells, wanted {len(names)}"
        )
    try:
        return [float(cell) for cell in cells]
    except ValueError as error:
        raise ConfigurationError("recording.not_a_number", f"{path}: line {number}: {error}") from error


LEAST_FIT_S = 4.0
LEAST_HELD_OUT_S = 2.0
MOST_PERIOD_S = 0.05
_UNEVEN = 0.2  # of the period
_MOVED_RAD = 2e-3
_LIVE_BAR = 0.3  # a chamber of a joint that moves changes by more
_STILL_RAD_S = 1e-3
_WAIT_S = 0.1  # after which a joint has followed its valve


class Machine(NamedTuple):
    """What a recording must be of: the arm's name, the hash of its nominal model, the set of its valves."""

    arm: str
    arm_hash: str
    valve_set: str


def check_recording(recording: MotionRecording, machine: Machine) -> list[int]:
    """The joints (0 to 5) that a recording moves by their valves, and that can be identified from it.

    Raises ConfigurationError for a recording of another machine, or one that cannot serve.
    """
    check_machine(recording, machine)
    check_samples(recording)
    return excited_joints(recording.part(0.0, recording.about.held_out_from_s))


def check_machine(recording: MotionRecording, machine: Machine) -> None:
    """Raise ConfigurationError when ``recording`` is of another arm or of other valves than ``machine``."""
    about = recording.about
    if (about.arm_hash, about.valve_set) == (machine.arm_hash, machine.valve_set):
        return
    what = "arm" if about.arm_hash != machine.arm_hash else "valve_set"
    raise ConfigurationError(
        f"recording.other_{what}",
        f"{what}: the recording is of '{about.arm}' ({about.arm_hash}) with {about.valve_set} valves,"
        f" the configuration of '{machine.arm}' ({machine.arm_hash}) with {machine.valve_set} valves",
    )


def check_samples(recording: MotionRecording) -> None:
    """Raise ConfigurationError for numbers that are not finite, times that do not go on, too little of it."""
    t = recording.time_s
    _check_finite(recording)
    steps = np.diff(t)
    back = np.flatnonzero(steps <= 0.0)
    if len(back):
        k = int(back[0])
        raise ConfigurationError(
            "recording.not_monotone", f"time_s: {t[k + 1]:g} follows {t[k]:g} at sample {k + 1}"
        )
    about = recording.about
    fit_s = min(about.held_out_from_s, float(t[-1])) if len(t) else 0.0
    left_s = float(t[-1]) - about.held_out_from_s if len(t) else 0.0
    if fit_s < LEAST_FIT_S or left_s < LEAST_HELD_OUT_S:
        raise ConfigurationError(
            "recording.too_short",
            f"{fit_s:.1f} s to fit and {max(left_s, 0.0):.1f} s held out,"
            f" wanted at least {LEAST_FIT_S:g} and {LEAST_HELD_OUT_S:g}",
        )
    period = recording.period_s
    if period > MOST_PERIOD_S:
        raise ConfigurationError(
            "recording.too_slow", f"a sample every {1e3 * period:.1f} ms, at most {1e3 * MOST_PERIOD_S:g}"
        )
    uneven = np.flatnonzero(np.abs(steps - period) > _UNEVEN * period)
    if len(uneven):
        k = int(uneven[0])
        raise ConfigurationError(
            "recording.uneven",
            f"time_s: {1e3 * steps[k]:.2f} ms after sample {k}, usual are {1e3 * period:.2f}",
        )
    _check_rest(recording)


def _check_finite(recording: MotionRecording) -> None:
    n = len(recording.time_s)
    parts = (recording.time_s, recording.valves, recording.angles, recording.pressures, recording.supply)
    table = np.column_stack([part.reshape(n, -1) for part in (*parts, recording.oil_degc)])
    wrong = np.argwhere(~np.isfinite(table))
    if len(wrong):
        k, column = wrong[0]
        raise ConfigurationError(
            "recording.not_finite",
            f"{COLUMNS[column]} = {table[k, column]} at sample {k}, one of {len(wrong)} such values",
        )


def _check_rest(recording: MotionRecording) -> None:
    rest = recording.time_s < recording.time_s[0] + recording.about.rest_s
    open_by = float(np.abs(recording.valves[rest]).max(initial=0.0))
    if open_by > 0.0:
        raise ConfigurationError(
            "recording.no_rest",
            f"rest_s = {recording.about.rest_s:g}: a valve word of {open_by:g} in that time",
        )


def excited_joints(recording: MotionRecording) -> list[int]:
    """The joints that their valves move. Raises ConfigurationError for none, or one that moves wrongly.

    A joint counts when its valve word changes and its angle with it.
    """
    valve_range = np.ptp(recording.valves, axis=0)
    moved = np.ptp(recording.angles, axis=0)
    joints = [j for j in range(len(JOINTS)) if valve_range[j] > 0.0 and moved[j] > _MOVED_RAD]
    if not joints:
        most = int(np.argmax(moved))
        raise ConfigurationError(
            "recording.no_excitation",
            f"no joint is moved by its valve: at most {JOINTS[most]} by {1e3 * moved[most]:.2f} mrad"
            f" (wanted {1e3 * _MOVED_RAD:g}), its valve word by {valve_range[most]:.4f} (wanted more than 0)",
        )
    for joint in joints:
        _check_joint(recording, joint)
    return joints


def _check_joint(recording: MotionRecording, joint: int) -> None:
    ranges = np.ptp(recording.pressures[:, joint], axis=0) / BAR
    if ranges.min() < _LIVE_BAR:
        side = "ab"[int(np.argmin(ranges))]
        raise ConfigurationError(
            "recording.no_pressures",
            f"pressure_{JOINTS[joint]}_{side}_bar stands still ({ranges.min():.3f} bar), the joint moves",
        )
    if (share := _right_way(recording, joint)) < 0.5:
        raise ConfigurationError(
            "recording.wrong_way",
            f"{JOINTS[joint]} follows the sign of its valve word in {100.0 * share:.0f} % of its motion:"
            " valve or encoder is swapped",
        )


def _right_way(recording: MotionRecording, joint: int) -> float:
    """The share of a joint's motion, by angle, that has the sign of the valve word that was in force."""
    lag = max(round(_WAIT_S / recording.period_s), 1)
    word = recording.valves[:-lag, joint]
    held = np.abs(word) >= 0.25 * np.abs(word).max()
    turned: Array = np.diff(recording.angles[:, joint])[lag - 1 :][: len(word)]
    fast = held[: len(turned)] & (np.abs(turned) > _STILL_RAD_S * recording.period_s)
    with_it = np.abs(turned[fast & (np.sign(turned) == np.sign(word[: len(turned)]))]).sum()
    return float(with_it / max(np.abs(turned[fast]).sum(), 1e-12))
