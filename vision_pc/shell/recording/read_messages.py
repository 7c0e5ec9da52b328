"""What programs read of arm and eyes, answer by answer: enough to run them again without either.

Numbers keep all their bits. Looks are told by number, since they are recorded as such.
"""

import asyncio
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from foundation.recording.messages import MessageField, message_class
from protocol import errors
from protocol.errors import LongreachError
from protocol.faults import FaultCode, GroupState, Severity
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraErrors,
    FrameObservation,
    Look,
    MisplacedMarker,
    StereoOffset,
    WatchHealth,
    WatchSample,
)

_VIEW = ("q_meas", "q_cmd", "X_BT", "X_BT_cmd", "unrest")
_CODES = ("time_ns", "group_state", "fault", "severity", "motion_id")
_PLACES = ("X_BT", "X_C0C", "X_CM", "X_CO")
_COUNTS = ("frames", "odometry_lost", "tool_missed", "object_missed", "median_inliers")
_OFFSET = tuple(f"offset_{name}_px" for name in ("x", "y", "std_x", "std_y"))


class Read(NamedTuple):
    """One answer that a program got: ``call`` says what it had asked for, such as ``arm.move_to``.

    ``error``: what was raised in place of an answer. ``samples``: how many of watch ``watch`` it was given.
    ``look``: the number of the look, from 1.
    """

    call: str
    error: BaseException | None = None
    view: ArmView | None = None
    watch: int | None = None
    samples: int | None = None
    look: int | None = None
    health: WatchHealth | None = None


class NumberedSample(NamedTuple):
    """Sample ``number``, from 0, of watch ``watch``."""

    watch: int
    number: int
    sample: WatchSample


def _integers(*names: str) -> list[MessageField]:
    return [MessageField(name, "int64") for name in names]


def _lists(*names: str) -> list[MessageField]:
    return [MessageField(name, repeated=True) for name in names]


ReadMessage = message_class(
    "Read",
    [
        *(MessageField(name, "string") for name in ("call", "error", "cause", "detail")),
        *_integers("watch", "samples", "look", *_CODES),
        *(MessageField(name, "bool") for name in ("motion_done", "settled")),
        *_lists(*_VIEW),
        *_integers(*_COUNTS),
        MessageField("last_loss", "string"),
        *map(MessageField, _OFFSET),
    ],
)
SampleMessage = message_class(
    "Sample",
    [
        *_integers("watch", "number", "time_ns"),
        *_lists(*_PLACES),
        *(MessageField(name, "bool") for name in ("observed", "errors_found")),
    ],
)


def read_bytes(read: Read) -> bytes:
    """longreach.Read."""
    said: dict[str, Any] = {name: getattr(read, name) for name in ("call", "watch", "samples", "look")}
    if read.error is not None:
        said |= {"error": type(read.error).__name__, "detail": str(read.error)}
        said["cause"] = getattr(read.error, "cause", None)
    if read.view is not None:
        said |= {name: int(getattr(read.view, name)) for name in _CODES}
        said |= {name: getattr(read.view, name) for name in ("motion_done", "settled")}
        said |= {name: np.ravel(getattr(read.view, name)).tolist() for name in _VIEW}
    if read.health is not None:
        said |= {name: getattr(read.health, name) for name in (*_COUNTS, "last_loss")}
        said |= {} if read.health.offset is None else dict(zip(_OFFSET, read.health.offset, strict=True))
    return bytes(ReadMessage(**_present_fields(said)).SerializeToString())


def sample_bytes(made: NumberedSample) -> bytes:
    """longreach.Sample: poses that were not measured are empty."""
    sample, seen = made.sample, made.sample.observation
    places = {name: getattr(sample, name) for name in _PLACES}
    said = {name: None if X is None else np.ravel(X).tolist() for name, X in places.items()}
    numbers = {"watch": made.watch, "number": made.number, "time_ns": sample.time_ns}
    known = {"observed": seen is not None, "errors_found": seen is not None and seen.errors is not None}
    return bytes(SampleMessage(**_present_fields(numbers | said | known)).SerializeToString())


def view_of_message(message: Any) -> ArmView:
    """The view that a longreach.Read holds."""
    q_meas, q_cmd, X_BT, X_BT_cmd, unrest = (np.array(getattr(message, name)) for name in _VIEW)
    return ArmView(
        time_ns=message.time_ns,
        group_state=GroupState(message.group_state),
        fault=FaultCode(message.fault),
        severity=Severity(message.severity),
        motion_id=message.motion_id,
        motion_done=message.motion_done,
        settled=message.settled,
        q_meas=q_meas,
        q_cmd=q_cmd,
        X_BT=X_BT.reshape(4, 4),
        X_BT_cmd=X_BT_cmd.reshape(4, 4),
        unrest=unrest,
    )


def health_of_message(message: Any) -> WatchHealth:
    """The health of a watch that a longreach.Read holds."""
    counts = {name: getattr(message, name) for name in _COUNTS}
    loss = message.last_loss if message.HasField("last_loss") else None
    return WatchHealth(**counts, last_loss=loss, offset=_offset(message))


def look_of_message(message: Any) -> Look:
    """The look that a longreach.Look holds."""
    plain = [name for name in Look._fields if name not in ("offset", "misplaced")]
    fields: dict[str, Any] = {name: getattr(message, name) for name in plain}
    for name, value in fields.items():
        if name.startswith("X_"):
            fields[name] = np.reshape(value, (4, 4))
        elif "cov_" in name:
            fields[name] = np.reshape(value, (6, 6))
    misplaced = None
    if message.HasField("misplaced_marker"):
        off_m, std_m = np.array(message.misplaced_off_m), np.array(message.misplaced_std_m)
        misplaced = MisplacedMarker(message.misplaced_marker, off_m, std_m)
    return Look(**fields, offset=_offset(message), misplaced=misplaced)


def sample_of_message(message: Any) -> WatchSample:
    """The sample that a longreach.Sample holds.

    Of its observation there are the poses; of the camera's errors there is whether they were found, and NaN
    in place of their values, which no program reads.
    """
    X_BT, X_C0C, X_CM, X_CO = (_pose(getattr(message, name)) for name in _PLACES)
    assert X_BT is not None
    seen = None
    if message.observed:
        unknown = CameraErrors(np.full(12, np.nan), np.full((12, 12), np.nan))
        found = unknown if message.errors_found else None
        seen = FrameObservation(
            message.time_ns, -1, X_CM, None, None, X_CO, None, None, (), {}, None, errors=found
        )
    return WatchSample(message.time_ns, X_BT, X_C0C, X_CM, X_CO, seen)


def error_of_message(message: Any) -> BaseException | None:
    """What was raised in place of an answer; None where there was one."""
    if not message.HasField("error"):
        return None
    if message.error == asyncio.CancelledError.__name__:
        return asyncio.CancelledError()
    kind = getattr(errors, message.error, None)
    if isinstance(kind, type) and issubclass(kind, LongreachError):
        return kind(message.cause, message.detail)
    return RuntimeError(f"{message.error}: {message.detail}")


def _pose(values: Sequence[float]) -> Array | None:
    return np.reshape(values, (4, 4)) if len(values) else None


def _offset(message: Any) -> StereoOffset | None:
    if not message.HasField(_OFFSET[0]):
        return None
    return StereoOffset(*(getattr(message, name) for name in _OFFSET))


def _present_fields(said: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in said.items() if value is not None}
