"""The truth as a Protobuf message: flat fields with their units in their names, read back to the last bit."""

from collections.abc import Iterator
from operator import attrgetter
from typing import Any

import numpy as np

from foundation.recording.messages import MessageField, message_class
from plant_emulator.core.camera.exposures import CameraMotion
from plant_emulator.core.layout import HINGES, JOINTS
from plant_emulator.core.truth import Array, PlantTruth

HOLES = "holes_C_m"
_AXES = ("x", "y", "z")
MOTION = tuple(
    f"{body}_{kind}_{axis}_{unit}"
    for body in ("camera", "marker")
    for kind, unit in (("velocity", "m_s"), ("turning", "rad_s"))
    for axis in _AXES
)
# What a plot may want of the truth has a column a number.
_COLUMNS: dict[str, tuple[str, ...]] = {
    "q": tuple(f"q_{joint}_rad" for joint in JOINTS),
    "q_rate": tuple(f"q_rate_{joint}_rad_s" for joint in JOINTS),
    "deflections": tuple(f"bending_{hinge}_rad" for hinge in HINGES),
    "p_CM": tuple(f"p_CM_{axis}_m" for axis in _AXES),
    "p_CO": tuple(f"p_CO_{axis}_m" for axis in _AXES),
    "pressures": tuple(f"pressure_{joint}_{side}_pa" for joint in JOINTS for side in "ab"),
    "valves": tuple(f"valve_{joint}" for joint in JOINTS),
    "spools": tuple(f"spool_{joint}" for joint in JOINTS),
    "flows": tuple(f"flow_{joint}_{side}_m3_s" for joint in JOINTS for side in "ab"),
}
_SHAPES = {"pressures": (len(JOINTS), 2), "flows": (len(JOINTS), 2)}
_MATRICES = dict.fromkeys(("X_BT", "X_WB", "X_WT", "X_WC", "X_WM", "X_WO"), (4, 4)) | dict.fromkeys(
    ("R_CM", "R_CO"), (3, 3)
)
_SCALARS = {"supply": "supply_pa", "oil_temperature_degc": "oil_temperature_degc", "payload_kg": "payload_kg"}


def _fields() -> Iterator[MessageField]:
    yield MessageField("frame_id", "int64")
    for name in PlantTruth._fields:
        if name in _COLUMNS:
            yield from map(MessageField, _COLUMNS[name])
        elif name in _MATRICES:
            yield MessageField(name, repeated=True)
        elif name in _SCALARS:
            yield MessageField(_SCALARS[name])
        else:
            yield MessageField(name, "string" if name == "faults" else "int64", repeated=name == "faults")
    yield MessageField(HOLES, repeated=True)
    yield from map(MessageField, MOTION)


TruthMessage = message_class("PlantTruth", list(_fields()))
_FLAT = tuple(column for columns in _COLUMNS.values() for column in columns)
_flat_of = attrgetter(*_FLAT)


def truth_bytes(
    truth: PlantTruth, frame_id: int | None, holes_O: Array | None = None, motion: CameraMotion | None = None
) -> bytes:
    """The message of a truth; ``frame_id`` None: it belongs to no frame.

    ``holes_O`` (n, 3): middles of the wall's drill holes, which are told in C. ``motion``: how camera and
    tool marker moved, where a picture depends on that.
    """
    values = np.concatenate([np.ravel(getattr(truth, name)) for name in _COLUMNS]).tolist()
    message = TruthMessage(**dict(zip(_FLAT, values, strict=True)))
    if frame_id is not None:
        message.frame_id = frame_id
    message.time_ns = truth.time_ns
    for name, column in _SCALARS.items():
        setattr(message, column, getattr(truth, name))
    for name in _MATRICES:
        getattr(message, name).extend(getattr(truth, name).ravel().tolist())
    message.faults.extend(truth.faults)
    if holes_O is not None:
        getattr(message, HOLES).extend((holes_O @ truth.R_CO.T + truth.p_CO).ravel().tolist())
    if motion is not None:
        for name, value in zip(MOTION, motion.rates.ravel().tolist(), strict=True):
            setattr(message, name, value)
    return bytes(message.SerializeToString())


def truth_of(data: bytes) -> tuple[PlantTruth, int | None, CameraMotion | None]:
    """The truth of a message, its frame, and how camera and marker moved, where that is told."""
    message = TruthMessage.FromString(data)
    flat, begun = np.array(_flat_of(message)), 0
    values: dict[str, Any] = {"time_ns": message.time_ns, "faults": tuple(message.faults)}
    for name, columns in _COLUMNS.items():
        shape = _SHAPES.get(name, (len(columns),))
        values[name] = flat[begun : begun + len(columns)].reshape(shape)
        begun += len(columns)
    for name, column in _SCALARS.items():
        values[name] = getattr(message, column)
    for name, matrix in _MATRICES.items():
        values[name] = np.array(getattr(message, name)).reshape(matrix)
    frame_id = message.frame_id if message.HasField("frame_id") else None
    if not message.HasField(MOTION[0]):
        return PlantTruth(**values), frame_id, None
    rates = np.array([getattr(message, name) for name in MOTION]).reshape(2, 6)
    return PlantTruth(**values), frame_id, CameraMotion(rates)
