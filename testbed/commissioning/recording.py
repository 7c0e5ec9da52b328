"""What the excitation of one joint recorded, as arrays, and the strokes in it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from controller.core.excitation.plan import Stroke, StrokeKind
from controller.core.excitation.program import ExcitationSample
from nominal_arm.description import CylinderDrive, NominalArm
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
