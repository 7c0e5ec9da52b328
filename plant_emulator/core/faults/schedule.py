"""Which faults are in force from when to when, in simulated time, and the trace that each of them leaves."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import Field

from foundation.configuration import StrictModel
from plant_emulator.core.faults.kinds import AnyFault, BaseFault, Fault, OwnFault
from protocol.errors import RequestRefused

LONGEST_S = 3600.0
MOST_BYTES = 1 << 16  # of a message; 64 faults are a third of it


class FaultOrder(StrictModel):
    """A fault, ``start_after_s`` of simulated time from now, for ``duration_s`` (null: until cleared)."""

    fault: Annotated[Fault, Field(discriminator="kind")]
    start_after_s: Annotated[float, Field(ge=0.0, le=LONGEST_S)] = 0.0
    duration_s: Annotated[float, Field(gt=0.0, le=LONGEST_S)] | None = None


class MendOrder(StrictModel):
    """Mend the fault of this number, or every fault (null)."""

    number: int | None


class RestartOrder(StrictModel):
    """End the emulator in good order; who supervises it starts it anew, with the world as it was at first."""

    restart: Literal[True] = True


class LookOrder(StrictModel):
    """Break and mend nothing: how things stand is in every answer."""

    look: Literal[True] = True


Order = FaultOrder | MendOrder | RestartOrder | LookOrder


class OrderMessage(StrictModel):
    """API → plant: the ``number``-th order."""

    number: int
    order: Order


class PlantAnswer(StrictModel):
    """Plant → API: what became of the ``number``-th order, and how things stand after it.

    ``concerned``: the faults that it made or mended; ``cause``, ``detail``: why it is refused. ``active``,
    ``planned``: faults at ``time_ns`` of simulated time; all faults as ``Injection.as_dict``.
    ``arm_points_m``: as ``true_points`` has them, where the truth is shown.
    """

    number: int
    time_ns: int
    active: list[dict[str, Any]]
    planned: list[dict[str, Any]]
    arm_points_m: list[list[float]] | None = None
    concerned: list[dict[str, Any]] = Field(default_factory=list)
    cause: str = ""
    detail: str = ""


MOST = 64
NEVER_NS = 1 << 62

Phase = Literal["planned", "began", "ended", "withdrawn"]
FaultT = TypeVar("FaultT", bound=BaseFault)


class Injection(NamedTuple):
    """A fault in force from ``start_ns`` until ``end_ns`` (None: until it is cleared), simulated time."""

    number: int
    fault: AnyFault
    start_ns: int
    end_ns: int | None

    def as_dict(self) -> dict[str, Any]:
        """What recording and HTTP face tell of it; times in nanoseconds of simulated time."""
        return {
            "number": self.number,
            "name": self.fault.name,
            "start_ns": self.start_ns,
            "end_ns": self.end_ns,
            "fault": self.fault.model_dump(mode="json"),
        }

    def elapsed_s(self, now_ns: int) -> float:
        """How long it has been in force at ``now_ns``."""
        return 1e-9 * (now_ns - self.start_ns)

    def again_ns(self, queried_ns: int) -> int:
        """When after ``queried_ns`` its effects on oil and load are asked again."""
        every_ns = round(1e9 * self.fault.every_s) if isinstance(self.fault, OwnFault) else 0
        if every_ns <= 0:
            return NEVER_NS
        return self.start_ns + ((queried_ns - self.start_ns) // every_ns + 1) * every_ns

    def overlaps(self, other: "Injection") -> bool:
        """Whether the two are ever in force together."""
        ends = [NEVER_NS if one.end_ns is None else one.end_ns for one in (self, other)]
        return self.start_ns < ends[1] and other.start_ns < ends[0]


class FaultChange(NamedTuple):
    """One step in the life of a fault; ``withdrawn`` is a planned one that was cleared before it began."""

    time_ns: int
    phase: Phase
    injection: Injection

    def as_dict(self) -> dict[str, Any]:
        """What the recording tells of it; times in nanoseconds of simulated time."""
        return {"phase": self.phase, "time_ns": self.time_ns} | self.injection.as_dict()


class FaultSchedule:
    """Planned faults and those in force. ``active`` is in the order in which they began; later ones win.

    The owner of the simulated time calls ``settle`` whenever it has passed ``next_ns``.
    """

    def __init__(self) -> None:
        self.active: tuple[Injection, ...] = ()
        self.planned: tuple[Injection, ...] = ()
        self.changes: list[FaultChange] = []
        self._numbers = 0
        self._queried_ns = 0

    def inject(
        self, fault: AnyFault, now_ns: int, start_ns: int | None = None, duration_ns: int | None = None
    ) -> Injection:
        """Plan ``fault`` from ``start_ns`` (None: now) for ``duration_ns`` (None: until cleared).

        Raises RequestRefused: ``refused.fault_time`` for a start in the past or a duration that is not
        positive, ``refused.fault_present`` when one of the same name would be in force at the same time,
        ``refused.too_many_faults`` beyond 64.
        """
        start_ns = now_ns if start_ns is None else start_ns
        if start_ns < now_ns:
            raise RequestRefused("refused.fault_time", f"start {start_ns} ns: it is {now_ns} ns already")
        if duration_ns is not None and duration_ns <= 0:
            raise RequestRefused("refused.fault_time", f"duration {duration_ns} ns: wanted more than 0")
        end_ns = None if duration_ns is None else start_ns + duration_ns
        known = self.all()
        if len(known) >= MOST:
            raise RequestRefused("refused.too_many_faults", f"{len(known)} faults: at most {MOST}")
        injection = Injection(self._numbers + 1, fault, start_ns, end_ns)
        for other in known:
            if other.fault.name == fault.name and other.overlaps(injection):
                raise RequestRefused(
                    "refused.fault_present", f"{fault.name}: number {other.number} is in force then"
                )
        self._numbers += 1
        self.planned = tuple(sorted((*self.planned, injection), key=lambda one: one.start_ns))
        if start_ns > now_ns:
            self._note(now_ns, "planned", injection)
        return injection

    def clear(self, number: int | None, now_ns: int) -> list[Injection]:
        """The fault of this number (None: all of them), over now. Raises RequestRefused for none of it."""
        over = [injection for injection in self.all() if number in (None, injection.number)]
        if not over and number is not None:
            raise RequestRefused("refused.no_such_fault", f"number {number}: neither in force nor planned")
        for injection in over:
            self._end(injection, now_ns)
        return over

    def next_ns(self) -> int:
        """When the next fault begins, ends, or is to be asked again."""
        if not (self.active or self.planned):
            return NEVER_NS
        starts = [one.start_ns for one in self.planned]
        ends = [one.end_ns for one in self.active if one.end_ns is not None]
        return min([*starts, *ends, self._again_ns(), NEVER_NS])

    def _again_ns(self) -> int:
        return min((one.again_ns(self._queried_ns) for one in self.active), default=NEVER_NS)

    def settle(self, now_ns: int) -> bool:
        """Let everything due by now begin or end; whether anything did, or is to be asked again."""
        before = self.active
        if not (before or self.planned):
            self._queried_ns = now_ns
            return False
        again = self._again_ns() <= now_ns
        self._queried_ns = now_ns
        for injection in before:
            if injection.end_ns is not None and injection.end_ns <= now_ns:
                self._end(injection, now_ns)
        for injection in self.planned:
            if injection.start_ns > now_ns:
                break
            self.planned = tuple(one for one in self.planned if one is not injection)
            self.active = (*self.active, injection)
            self._note(now_ns, "began", injection)
        return again or self.active != before

    def all(self) -> tuple[Injection, ...]:
        """Those in force and those planned."""
        return self.active + self.planned

    def of_kind(self, kind: type[FaultT]) -> FaultT | None:
        """The latest fault of this kind in force, or None."""
        return next((one.fault for one in reversed(self.active) if isinstance(one.fault, kind)), None)

    def in_force(self) -> Sequence[AnyFault]:
        """The faults in force, oldest first."""
        return [injection.fault for injection in self.active]

    def _end(self, injection: Injection, now_ns: int) -> None:
        phase: Phase = "ended" if injection in self.active else "withdrawn"
        self.active = tuple(one for one in self.active if one is not injection)
        self.planned = tuple(one for one in self.planned if one is not injection)
        self._note(now_ns, phase, injection)

    def _note(self, time_ns: int, phase: Phase, injection: Injection) -> None:
        self.changes.append(FaultChange(time_ns, phase, injection))
