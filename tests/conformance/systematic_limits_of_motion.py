"""Controllers whose limits and times of motions and streams are off.

Clauses 6.7 to 6.9 and 12. Where a limit is off its refusals still name the shipped one: a controller
with a narrower limit that it names is a sound one.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from controller.core.settings import ScanSettings
from protocol.faults import Reason
from protocol.reference_messages import (
    Acknowledgement,
    StreamRefused,
)
from tests.conformance.controllers import ControllerUnderTest, settings
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.breaking import reworked

Make = Callable[[], ControllerUnderTest]


class OfOtherSettings(ControllerUnderTest):
    """Runs with other settings; refusals for ``reason`` name ``limit`` instead of the limit in use."""

    def __init__(
        self, configured: Callable[[], ScanSettings], named: dict[Reason, Callable[[float], float]]
    ) -> None:
        self._other = configured
        self._named = named
        super().__init__()

    def configured(self) -> ScanSettings:
        return self._other()

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        name = self._named.get(acknowledgement.reason)
        if name is None:
            return [acknowledgement]
        return [acknowledgement._replace(limit=name(acknowledgement.limit))]

    def outgoing(self, data: bytes) -> list[bytes]:
        def renamed(refused: StreamRefused) -> StreamRefused:
            name = self._named.get(refused.reason)
            return refused if name is None else refused._replace(limit=name(refused.limit))

        return [reworked(data, StreamRefused, renamed)]


def _other(override: str, **named: Callable[[float], float]) -> Make:
    names = {Reason[reason]: limit for reason, limit in named.items()}
    return partial(OfOtherSettings, partial(settings, f"controller.{override}"), names)


def _always(limit: float) -> Callable[[float], float]:
    return lambda _: limit


def _one_of(*pairs: tuple[float, float]) -> Callable[[float], float]:
    """Names the second of a pair for the first, and others as they are."""
    return lambda limit: next((said for used, said in pairs if math.isclose(used, limit)), limit)


def _times() -> Iterator[BrokenController]:
    for silence_ms in (50, 70, 120, 200, 900):
        make = _other(f"streaming.silence_ms={silence_ms}")
        yield BrokenController(f"silence_ms of {silence_ms}", "12.8", make, case=572)
    for ramp_ms, case in ((2.0, 572), (72, 573)):
        yield BrokenController(
            f"ramp_ms of {ramp_ms}", "12.8", _other(f"streaming.ramp_ms={ramp_ms}"), case=case
        )
    for first_ms in (500, 2000, 5000):
        make = _other(f"streaming.first_reference_ms={first_ms}")
        yield BrokenController(f"first_reference_ms of {first_ms}", "12.8", make, case=574)
    unseen = "to slow down 12 ms early costs a hundredth of a millimetre"
    yield BrokenController("ramp_ms of 24", "12.8", _other("streaming.ramp_ms=24"), unseen=unseen)
    for recovery_ms in (200, 1000):
        make = _other(f"streaming.recovery_ms={recovery_ms}")
        yield BrokenController(f"recovery_ms of {recovery_ms}", "12.8", make, case=575)
    unseen = "back at full pace sooner: what is bounded is how late"
    yield BrokenController("recovery_ms of 50", "12.8", _other("streaming.recovery_ms=50"), unseen=unseen)


def _stream_limits() -> Iterator[BrokenController]:
    degree = math.pi / 180.0
    for factor in (0.5, 0.9, 1.1, 2.0):
        far = _one_of((0.5 * factor, 0.5))
        make = _other(f"streaming.distance_m={0.5 * factor}", TOO_FAR=far)
        yield BrokenController(f"distance of {factor:g} of its limit", "12.4", make, case=581)
        turn = _one_of((30.0 * factor * degree, 30.0 * degree))
        make = _other(f"streaming.turn_deg={30.0 * factor}", TOO_FAR=turn)
        yield BrokenController(f"angle of {factor:g} of its limit", "12.4", make, case=582)
        make = _other(f"streaming.max_age_ms={250.0 * factor}", STALE=_always(0.25))
        yield BrokenController(f"age of {factor:g} of its limit", "12.6", make, case=584)
        for axes in ("speed_m_s=0.25", "turn_speed_deg_s=12.0"):
            name, _, value = axes.partition("=")
            make = _other(f"streaming.{name}={float(value) * factor}", TOO_FAST=lambda x, f=factor: x / f)
            yield BrokenController(f"stream {name} of {factor:g} of its limit", "12.4", make, case=583)
    for what in ("distance_m=5.0", "turn_deg=90.0", "max_age_ms=4000.0", "speed_m_s=1.0"):
        case = {"distance_m": 581, "turn_deg": 582, "max_age_ms": 584, "speed_m_s": 583}[
            what.partition("=")[0]
        ]
        yield BrokenController(
            f"streaming {what}, and names it", "12.4", _other(f"streaming.{what}"), case=case
        )
    for what in ("acceleration_m_s2=0.7", "acceleration_m_s2=3.0", "jerk_m_s3=6.0", "jerk_m_s3=100.0"):
        yield BrokenController(f"streaming {what}", "12.7", _other(f"streaming.{what}"), case=579)


def _lower_floor(metres: float) -> ScanSettings:
    sound = settings()
    box = sound.planning.workspace.box.copy()
    box[2, 0] += metres
    space = sound.planning.workspace._replace(box=box)
    return replace(sound, planning=sound.planning._replace(workspace=space))


def _wider_joint(radians: float) -> ScanSettings:
    sound = settings()
    bounds = np.array(sound.planning.planned_range)
    bounds[:, 5] += (-radians, radians)
    return replace(sound, planning=sound.planning._replace(planned_range=bounds))


def _motion_limits() -> Iterator[BrokenController]:
    sound = settings()
    least, most, first = (
        sound.motion.duration_min,
        sound.motion.duration_max,
        sound.motion.first_point_distance,
    )
    for factor in (0.5, 0.9, 1.1, 2.0):
        for key, limit in (("duration_min_s", least), ("duration_max_s", most)):
            make = _other(f"motion.{key}={limit * factor}", BAD_DURATION=_one_of((limit * factor, limit)))
            yield BrokenController(f"{key} of {factor:g} of its limit", "6.7", make, case=561)
            yield BrokenController(f"{key} of {factor:g} of its limit, paths", "6.8", make, case=562)
        make = _other(f"motion.first_point_distance_m={first * factor}", TOO_FAR=_always(first))
        yield BrokenController(f"first pose of {factor:g} of its limit", "6.9", make, case=564)
        for key, limit in (("speed_m_s", 0.25), ("acceleration_m_s2", 0.25)):
            bounds = _one_of((limit * factor, limit))
            make = _other(f"motion.{key}={limit * factor}", TOO_FAST=bounds)
            unseen = "60 mm are too short a way to reach it" if key == "speed_m_s" else ""
            yield BrokenController(
                f"{key} of {factor:g} of its limit", "6.9", make, unseen=unseen, case=0 if unseen else 563
            )
    for factor in (0.5, 2.0):
        make = _other(f"motion.singular_value_min={0.05 * factor}", SINGULAR=_always(0.05))
        yield BrokenController(f"singular value of {factor:g} of its limit", "6.9", make, case=567)
    for metres in (-0.3, -0.05, 0.05, 0.3):
        floor = float(sound.planning.workspace.box[2, 0])
        make = partial(
            OfOtherSettings, partial(_lower_floor, metres), {Reason.OUTSIDE_WORKSPACE: _always(floor)}
        )
        yield BrokenController(f"workspace off by {metres:g} m", "6.9", make, case=565)
    for radians in (-0.2, -0.03, 0.03, 0.2):
        bounds = sound.planning.planned_range[:, 5]
        named = _one_of(
            *((float(b + s * radians), float(b)) for b, s in zip(bounds, (-1.0, 1.0), strict=True))
        )
        make = partial(OfOtherSettings, partial(_wider_joint, radians), {Reason.JOINT_LIMIT: named})
        yield BrokenController(f"joint range off by {radians:g} rad", "6.9", make, case=566)


MUTANTS = (*_times(), *_stream_limits(), *_motion_limits())
