"""A recording of an arm's motion for identification: one CSV file that any controller can write.

Lines that begin with ``#`` are a YAML mapping about the whole (``About``); then a line of column names and
one line for each sample. A sample's sensors are those of its time; its valve words are in force from then
until the next sample. Joint order: slew, lift, tilt, wrist1, wrist2, wrist3.
"""

import csv
import hashlib
import io
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field

from foundation.configuration import StrictModel, validated
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
        lines = data.decode().splitlines()
    except OSError as error:
        raise ConfigurationError("recording.unreadable", f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            "recording.unreadable", f"{path}: not UTF-8 at byte {error.start}"
        ) from error
    told = [line.removeprefix("#").removeprefix(" ") for line in lines if line.startswith("#")]
    if not told or told[0].strip() != FIRST_LINE:
        raise ConfigurationError("recording.not_one", f"{path}: the first line is not '# {FIRST_LINE}'")
    about = _about("\n".join(told[1:]), path)
    body = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
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


def _about(text: str, path: Path) -> About:
    try:
        told: Any = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigurationError("recording.not_one", f"{path}: {' '.join(str(error).split())}") from error
    return validated(About, told if isinstance(told, dict) else {}, str(path))


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
