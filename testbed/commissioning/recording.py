"""What commissioning records: the ramps of each joint, and the session that they belong to."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from controller.core.excitation.plan import Stroke, StrokeKind
from controller.core.excitation.program import ExcitationSample
from foundation.configuration import StrictModel, validated
from nominal_arm.description import JOINT_NAMES, CylinderDrive, NominalArm
from plant_emulator.config.valves import JointName
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]

_ATMOSPHERE_BAR = 1.01
_LEAST_BAR = 0.1  # cavitation: nothing is told of air there
_POLYTROPIC = 1.2  # of air in oil: 1 where it keeps the oil's temperature, 1.4 where it has no time to


class SeenPose(NamedTuple):
    """The camera's pose in its first frame (4, 4) by odometry, at ``time_ns`` of the controller's clock."""

    time_ns: int
    X_C0C: Array


class JointRecording(NamedTuple):
    """All scans of one joint's strokes, SI and bar.

    ``t`` (n,) s; ``stroke`` (n,), from 0; ``valve`` (n,) commanded, signed; ``q`` (n, 6); ``chambers`` (n, 2)
    bar; ``supply`` (n,) bar; ``full_speed`` (n, 2): nominal, unloaded, raising and lowering; ``kinds``,
    ``outward``: of each stroke. ``area_ratio``: chamber b to a. ``rated`` (2,): supply and return at which
    the nominal speeds hold, bar; ``back`` (n,): return pressure. ``seen_t`` (m,) s and ``seen_X`` (m, 4, 4):
    when the camera's pose was seen by odometry, and where; empty where nobody looked.
    """

    joint: int
    t: Array
    stroke: Array
    driving: NDArray[np.bool_]
    valve: Array
    q: Array
    chambers: Array
    supply: Array
    back: Array
    full_speed: Array
    kinds: Array
    area_ratio: float
    rated: Array
    seen_t: Array = np.zeros(0)
    seen_X: Array = np.zeros((0, 4, 4))

    def save(self, path: Path) -> None:
        """Write all arrays to one compressed file."""
        np.savez_compressed(path, **{name: np.asarray(value) for name, value in self._asdict().items()})  # type: ignore[arg-type]


def recording_of(
    arm: NominalArm,
    joint: int,
    strokes: Sequence[Stroke],
    samples: Sequence[ExcitationSample],
    seen: Sequence[SeenPose] = (),
) -> JointRecording:
    """The recording of ``joint`` out of all ``samples``, and what of ``seen`` falls into its time."""
    mine = [k for k, stroke in enumerate(strokes) if stroke.joint == joint]
    rows = [sample for sample in samples if sample.stroke in mine]
    drive = arm.drives[joint]
    poses = [pose for pose in seen if rows[0].time_ns <= pose.time_ns <= rows[-1].time_ns]
    return JointRecording(
        joint=joint,
        t=1e-9 * np.array([row.time_ns - rows[0].time_ns for row in rows], dtype=np.float64),
        stroke=np.array([row.stroke - mine[0] for row in rows], dtype=np.float64),
        driving=np.array([row.driving for row in rows]),
        valve=np.array([row.valve for row in rows]),
        q=np.array([row.q for row in rows]),
        chambers=np.array([row.pressures_bar[joint] for row in rows]),
        supply=np.array([row.supply_bar for row in rows]),
        back=np.array([row.return_bar for row in rows]),
        full_speed=np.array([row.full_speed for row in rows]),
        kinds=np.array([float(strokes[k].kind) for k in mine]),
        area_ratio=drive.area_ratio if isinstance(drive, CylinderDrive) else 1.0,
        rated=np.array([arm.rated.supply_bar, arm.rated.return_bar]),
        seen_t=1e-9 * np.array([pose.time_ns - rows[0].time_ns for pose in poses], dtype=np.float64),
        seen_X=np.array([pose.X_C0C for pose in poses]).reshape(-1, 4, 4),
    )


def load_recording(path: Path) -> JointRecording:
    """The recording in ``path``. Raises ConfigurationError when it is none."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as found:
            data = {name: found[name] for name in JointRecording._fields}
    except (OSError, ValueError, KeyError, BadZipFile, EOFError) as error:
        raise ConfigurationError("commissioning.bad_recording", f"{path}: {error}") from error
    return JointRecording(**data)._replace(joint=int(data["joint"]), area_ratio=float(data["area_ratio"]))


class StrokeRecord(NamedTuple):
    """One stroke, along its own sense: everything positive that helps it.

    ``u`` (n,): the spool's size; ``turned`` (n,) rad; ``q`` (n,). ``e`` (n,) rad/s: nominal speed at full
    opening by the pressure left across the edge that fills, ``inlet`` (n,) bar: of the chamber that it fills.
    ``load`` (n,): p_a − ratio · p_b, bar, positive against the motion. ``e_by_outlet``, ``outlet``: as ``e``
    and ``inlet``, of the edge and the chamber that are emptied. ``fed_bar`` (n,): by how much ``inlet`` is
    above the tank. ``air`` (n,): how far air in the oil of ``inlet`` is compressed, as a share of its volume
    at the atmosphere. ``nominal`` (n,) rad/s: at the rated pressures. ``top``: index of the greatest spool.
    """

    kind: StrokeKind
    sense: float
    t: Array
    u: Array
    turned: Array
    e: Array
    inlet: Array
    load: Array
    q: Array
    top: int
    nominal: Array
    e_by_outlet: Array
    outlet: Array
    fed_bar: Array
    air: Array

    @property
    def compensated(self) -> bool:
        """Whether ``e`` is that of a valve whose flow is independent of the load."""
        return np.array_equal(self.e, self.nominal)


def strokes_in(recording: JointRecording, compensated: bool) -> list[StrokeRecord]:
    """The strokes in the order in which they were driven; one that never moved the spool is left out.

    ``compensated``: whether the valve's flow is independent of the load.
    """
    found = []
    for k, kind in enumerate(recording.kinds):
        rows = np.flatnonzero((recording.stroke == k) & recording.driving)
        valve = recording.valve[rows]
        if len(rows) < 10 or not np.any(valve):
            continue
        sense = float(np.sign(valve[np.argmax(np.abs(valve))]))
        found.append(_along(recording, StrokeKind(int(kind)), rows, sense))
    if compensated:
        return [s._replace(e=s.nominal) for s in found]
    return found


def _along(rec: JointRecording, kind: StrokeKind, rows: NDArray[np.intp], sense: float) -> StrokeRecord:
    u = sense * rec.valve[rows]
    q = rec.q[rows, rec.joint]
    load = rec.chambers[rows, 0] - rec.area_ratio * rec.chambers[rows, 1]
    inlet, outlet = rec.chambers[rows].T if sense > 0.0 else rec.chambers[rows, ::-1].T
    return StrokeRecord(
        kind=kind,
        sense=sense,
        t=rec.t[rows] - rec.t[rows[0]],
        u=u,
        turned=sense * (q - q[0]),
        e=_available(rec, rows, inlet, sense),
        inlet=inlet,
        load=sense * load,
        q=q,
        top=int(np.argmax(u)),
        nominal=rec.full_speed[rows, 0 if sense > 0.0 else 1],
        e_by_outlet=_available_by_outlet(rec, rows, outlet, sense),
        outlet=outlet,
        fed_bar=inlet - rec.back[rows],
        air=air_compressed(inlet),
    )


def air_compressed(pressure: Array) -> Array:
    """The share (n,) of its volume at the atmosphere that air loses at ``pressure`` (bar, absolute)."""
    return np.asarray(1.0 - (_ATMOSPHERE_BAR / np.maximum(pressure, _LEAST_BAR)) ** (1.0 / _POLYTROPIC))


def _available(rec: JointRecording, rows: NDArray[np.intp], inlet: Array, sense: float) -> Array:
    """Nominal speed with the filling edge full open, at the pressure that is left across it.

    Source: free speed v = K √((A_a p_s − A_b p_t)/(A_a³ + A_b³)) and A_a v = K √(p_s − p_a) give the drop at
    which the nominal speed holds, (p_s − r p_t)/(1 + r³) with r = A_b/A_a; retracting, r² (r p_s − p_t)
    over the same.
    """
    r, (supply, back) = rec.area_ratio, rec.rated
    raising = sense > 0.0
    rated = (supply - r * back if raising else r * r * (r * supply - back)) / (1.0 + r**3)
    left = np.maximum(rec.supply[rows] - inlet, 1.0)
    return np.asarray(rec.full_speed[rows, 0 if raising else 1] * np.sqrt(left / rated))


def _available_by_outlet(rec: JointRecording, rows: NDArray[np.intp], outlet: Array, sense: float) -> Array:
    """Nominal speed with the emptying edge full open, at the pressure across it to the tank.

    As in ``_available`` with A_b v = K √(p_b − p_t): at the nominal speed the drop is r² times the filling
    edge's, extending, and 1/r² times that, retracting.
    """
    r, (supply, back) = rec.area_ratio, rec.rated
    raising = sense > 0.0
    rated = (r * r * (supply - r * back) if raising else r * supply - back) / (1.0 + r**3)
    left = np.maximum(outlet - rec.back[rows], 0.0)
    return np.asarray(rec.full_speed[rows, 0 if raising else 1] * np.sqrt(left / rated))


_SEEN = "seen.json"
_DIGITS = 16  # of a recording's hash, told with every number


class ToldNumber(StrictModel):
    """A number and its standard deviation, in the unit that its name says."""

    value: float
    std: Annotated[float, Field(gt=0.0)]


class TrialsTold(StrictModel):
    """What ``valve-trials`` answers: half the plays, why others were not seen, the camera's delay."""

    play_mrad: dict[JointName, ToldNumber]
    unseen: dict[JointName, str] = Field(default_factory=dict)
    camera_delay_ms: ToldNumber | None = None


def trials_told(path: Path) -> TrialsTold:
    """What the vision PC told in ``path``: the operation as its API gives it, or its result alone.

    Raises ConfigurationError: ``commissioning.no_trials`` for one that failed, ``commissioning.bad_session``,
    ``configuration.…`` for anything else.
    """
    found = _read_json(path)
    if found is None:
        raise ConfigurationError("commissioning.bad_session", f"{path}: no such file")
    problem = found.get("problem") or found
    if isinstance(problem, dict) and "cause" in problem:
        why = f"{problem['cause']}: {problem.get('detail')}"
        raise ConfigurationError("commissioning.no_trials", f"{path}: the operation failed: {why}")
    return validated(TrialsTold, found.get("result") or found, str(path))


class CommissioningSession:
    """What a session directory holds; every finished joint is kept at once.

    Raises ConfigurationError (``commissioning.other_session``) for a directory that was begun with another
    arm or configuration, ``commissioning.bad_session`` for one that cannot be read.
    """

    def __init__(self, directory: Path, arm: NominalArm, config: ControllerConfig) -> None:
        self.directory = directory
        basis = basis_of(arm, config).model_dump()
        self._state = _read_json(directory / "session.json") or {"basis": basis, "ended_by": None}
        if self._state.get("basis") != basis:
            raise ConfigurationError(
                "commissioning.other_session",
                f"{directory}: begun with {self._state.get('basis')}, this machine is {basis}; take another "
                "directory",
            )

    @property
    def finished(self) -> dict[int, Path]:
        """The recording of every finished joint."""
        files = {joint: self._file(joint) for joint in range(len(JOINT_NAMES))}
        return {joint: path for joint, path in files.items() if path.is_file()}

    def recordings(self) -> dict[int, JointRecording]:
        """All recordings, read. Raises ConfigurationError for one that is none."""
        return {joint: load_recording(path) for joint, path in self.finished.items()}

    def source(self, joint: int) -> str:
        """How a number names the recording that it came from: file and hash."""
        path = self._file(joint)
        return f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:_DIGITS]}"

    def keep(self, recording: JointRecording) -> None:
        """Keep the recording of a finished joint."""
        self._write()
        recording.save(self._file(recording.joint))

    @property
    def seen(self) -> TrialsTold | None:
        """Plays and delay that the vision PC has told, None for none."""
        path = self.directory / _SEEN
        return trials_told(path) if path.is_file() else None

    def keep_seen(self, seen: TrialsTold) -> None:
        """Keep what the vision PC tells of joints, with what it told of others before."""
        before = self.seen
        if before is not None:
            seen = seen.model_copy(update={"play_mrad": before.play_mrad | seen.play_mrad})
        self._write()
        (self.directory / _SEEN).write_text(seen.model_dump_json(indent=2) + "\n", encoding="utf-8")

    def ended_by(self, cause: str | None) -> None:
        """Note what broke the latest run off, None for nothing."""
        self._state["ended_by"] = cause
        self._write()

    def _file(self, joint: int) -> Path:
        return self.directory / f"{JOINT_NAMES[joint]}.npz"

    def _write(self) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            text = json.dumps(self._state, indent=2) + "\n"
            (self.directory / "session.json").write_text(text, encoding="utf-8")
        except OSError as error:
            raise ConfigurationError("output.unwritable", f"{self.directory}: {error.strerror}") from error


def _read_json(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigurationError("commissioning.bad_session", f"{path}: {error}") from error
    if not isinstance(found, dict):
        raise ConfigurationError("commissioning.bad_session", f"{path}: a mapping is wanted")
    return found
