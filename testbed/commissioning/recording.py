"""What commissioning records: the strokes of each joint, and the session that they belong to."""

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from controller.core.excitation.plan import Failure, Stroke, StrokeKind
from controller.core.excitation.program import ExcitationSample
from controller.shell.scan_recorder import SUMMARY, TrialFile, summarise, write_trial
from nominal_arm.description import JOINT_NAMES, CylinderDrive, NominalArm
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]

_ATMOSPHERE_BAR = 1.01
_LEAST_BAR = 0.1  # cavitation: nothing is told of air there
_POLYTROPIC = 1.2  # of air in oil: 1 where it keeps the oil's temperature, 1.4 where it has no time to


class JointRecording(NamedTuple):
    """All scans of one joint's strokes, SI and bar.

    ``t`` (n,) s; ``stroke`` (n,), from 0; ``valve`` (n,) commanded, signed; ``q`` (n, 6); ``chambers`` (n, 2)
    bar; ``supply`` (n,) bar; ``full_speed`` (n, 2): nominal, unloaded, raising and lowering; ``kinds``,
    ``outward``: of each stroke. ``area_ratio``: chamber b to a. ``rated`` (2,): supply and return at which
    the nominal speeds hold, bar; ``back`` (n,): return pressure.
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


def recording_of(
    arm: NominalArm, joint: int, strokes: Sequence[Stroke], samples: Sequence[ExcitationSample]
) -> JointRecording:
    """The recording of ``joint`` out of all ``samples``."""
    mine = [k for k, stroke in enumerate(strokes) if stroke.joint == joint]
    rows = [sample for sample in samples if sample.stroke in mine]
    drive = arm.drives[joint]
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
    )


class StrokeRecord(NamedTuple):
    """One stroke, along its own sense: everything positive that helps it.

    ``u`` (n,): the spool's size; ``turned`` (n,) rad. ``e`` (n,) rad/s: nominal speed at full
    opening by the pressure left across the edge that fills, ``inlet`` (n,) bar: of the chamber that it fills.
    ``e_by_outlet``, ``outlet``: as ``e``
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
    """The stroke of ``rows`` along ``sense``, with the nominal speed of either edge full open at the pressure
    that is left across it.

    Source: free speed v = K √((A_a p_s − A_b p_t)/(A_a³ + A_b³)) and A_a v = K √(p_s − p_a) give the drop of
    the filling edge at which the nominal speed holds, (p_s − r p_t)/(1 + r³) with r = A_b/A_a; retracting,
    r² (r p_s − p_t) over the same. By A_b v = K √(p_b − p_t) the emptying edge's is r² times that, extending,
    and 1/r² times that, retracting.
    """
    r, (supply, back) = rec.area_ratio, rec.rated
    rated = (supply - r * back if sense > 0.0 else r * r * (r * supply - back)) / (1.0 + r**3)
    nominal = rec.full_speed[rows, 0 if sense > 0.0 else 1]
    u = sense * rec.valve[rows]
    q = rec.q[rows, rec.joint]
    inlet, outlet = rec.chambers[rows].T if sense > 0.0 else rec.chambers[rows, ::-1].T
    return StrokeRecord(
        kind=kind,
        sense=sense,
        t=rec.t[rows] - rec.t[rows[0]],
        u=u,
        turned=sense * (q - q[0]),
        e=nominal * np.sqrt(np.maximum(rec.supply[rows] - inlet, 1.0) / rated),
        inlet=inlet,
        top=int(np.argmax(u)),
        nominal=nominal,
        e_by_outlet=nominal * np.sqrt(np.maximum(outlet - rec.back[rows], 0.0) / rated * r ** (-2.0 * sense)),
        outlet=outlet,
        fed_bar=inlet - rec.back[rows],
        air=air_compressed(inlet),
    )


def air_compressed(pressure: Array) -> Array:
    """The share (n,) of its volume at the atmosphere that air loses at ``pressure`` (bar, absolute)."""
    return np.asarray(1.0 - (_ATMOSPHERE_BAR / np.maximum(pressure, _LEAST_BAR)) ** (1.0 / _POLYTROPIC))


_DIGITS = 16  # of a recording's hash, told with every number


class TrialSession:
    """The trials of one machine's joints in a directory: a controller's own, or those of the emulated arm.

    Both have the form of ``controller.shell.scan_recorder.TrialRecords``; every finished joint is kept at
    once.
    """

    def __init__(self, directory: Path, arm: NominalArm, config: ControllerConfig, *, began: bool) -> None:
        """``began``: whether the directory must hold trials already.

        Raises ConfigurationError: ``commissioning.other_session`` where they are of another arm or
        configuration, ``commissioning.no_trials`` where there are none.
        """
        self._directory, self._arm = directory, arm
        basis = basis_of(arm, config).model_dump()
        self._summary: dict[str, Any] = {"basis": basis, "finished": [], "ended_by": None, "whole": False}
        path = directory / SUMMARY
        if began or path.exists():
            self._summary = _read_summary(path)
        if self._summary["basis"] != basis:
            raise ConfigurationError(
                "commissioning.other_session",
                f"{path}: made with {self._summary['basis']}, this machine is {basis}; take another",
            )

    @property
    def finished(self) -> list[int]:
        """The joints that are finished."""
        return [JOINT_NAMES.index(name) for name in self._summary["finished"]]

    @property
    def failure(self) -> Failure | None:
        """What broke off the latest trial."""
        ended = self._summary["ended_by"]
        if ended is None:
            return None
        joint = JOINT_NAMES.index(ended["joint"])
        return Failure(ended["cause"], joint, float(ended["value"]), float(ended["limit"]))

    def recordings(self) -> dict[int, JointRecording]:
        """All recordings, read. Raises ConfigurationError for one that is none."""
        return {j: recording_of(self._arm, j, *read_trial(self._file(j))) for j in sorted(self.finished)}

    def source(self, joint: int) -> str:
        """How a number names the recording that it came from: file and hash."""
        path = self._file(joint)
        return f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:_DIGITS]}"

    def keep(self, joint: int, strokes: Sequence[Stroke], samples: Sequence[ExcitationSample]) -> None:
        """Keep the trial of a finished joint. Raises ConfigurationError (``output.unwritable``)."""
        finished = [*self._summary["finished"], JOINT_NAMES[joint]]
        self._summary |= {"finished": finished, "ended_by": None}
        trial = TrialFile(self._file(joint), list(samples), tuple(strokes), self._summary)
        self._write(lambda: write_trial(trial))

    def ended_by(self, failure: Failure) -> None:
        """Note what broke the latest trial off."""
        self._summary["ended_by"] = failure._asdict() | {"joint": JOINT_NAMES[failure.joint]}
        self._write(lambda: summarise(self._directory, self._summary))

    def _file(self, joint: int) -> Path:
        return self._directory / f"trial_{JOINT_NAMES[joint]}.jsonl"

    def _write(self, write: Callable[[], None]) -> None:
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            write()
        except OSError as error:
            raise ConfigurationError("output.unwritable", f"{self._directory}: {error.strerror}") from error


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return {key: summary[key] for key in ("basis", "finished", "ended_by", "whole")}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(
            "commissioning.no_trials",
            f"{path}: {error}; start the controller with controller.excitation.enabled=true and "
            "--record-dir, and name that directory",
        ) from error


def read_trial(path: Path) -> tuple[list[Stroke], list[ExcitationSample]]:
    """The strokes and the scans in a controller's recording of one joint.

    Raises ConfigurationError (``commissioning.bad_recording``) when it is none.
    """
    try:
        with path.open(encoding="utf-8") as file:
            header = json.loads(file.readline())
            rows = [json.loads(line) for line in file]
        strokes = [Stroke(each[0], StrokeKind(each[1]), *each[2:]) for each in header["strokes"]]
        return strokes, [ExcitationSample(*row) for row in rows]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigurationError("commissioning.bad_recording", f"{path}: {error}") from error
