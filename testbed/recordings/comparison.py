"""What was recorded beside what comes out again: to the last bit, or within a limit, and where they part."""

import math
from collections import Counter
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from foundation.recording.decoding import Values, decoder
from foundation.recording.messages import format_of
from vision_pc.shell.recording import vision_messages as own

ALIKE = 1e-9  # of other versions or another processor: m, rad, px


class Difference(NamedTuple):
    """The first place where a replay parts from its recording, ``time_ns`` on vision's clock."""

    kind: str
    number: int
    time_ns: int
    field: str
    recorded: Any
    replayed: Any

    def in_words(self) -> str:
        """One line that says it all."""
        where = f"{self.kind} {self.number} (captured at {self.time_ns * 1e-9:.3f} s): {self.field}"
        return f"{where}: recorded {_as_text(self.recorded)}, replayed {_as_text(self.replayed)}"


class ReplayComparison:
    """Counts what is the same, by kind, and keeps the first that is not.

    ``exact``: the same is what has the same digest; otherwise what differs in no field by more than
    ``ALIKE``, for other versions of the libraries. ``largest`` is the largest difference of a number.
    """

    def __init__(self, exact: bool) -> None:
        self.exact = exact
        self.alike: Counter[str] = Counter()
        self.of: Counter[str] = Counter()
        self.first: Difference | None = None
        self.largest = 0.0

    @property
    def identical(self) -> bool:
        """Whether everything was the same."""
        return self.alike == self.of

    def message(self, kind: str, number: int, recorded: Any, replayed: bytes) -> bool:
        """Compare a recorded message with the bytes of a replayed one. Return whether they are the same."""
        again = type(recorded).FromString(replayed)
        digests = [getattr(message, "digest", None) for message in (recorded, again)]
        if self.exact and digests[0] is not None and digests[0] == digests[1]:
            return self.same(kind)
        parted = self._first_difference(_flat(recorded), _flat(again))
        if parted is None and self.exact and digests[0] != digests[1]:
            parted = "digest", digests[0], digests[1]
        return self.same(kind) if parted is None else self.different(kind, number, _stamp(recorded), *parted)

    def _first_difference(self, before: Values, now: Values) -> tuple[str, Any, Any] | None:
        """The first field that is not the same, and both its values."""
        for field in [*before, *(field for field in now if field not in before)]:
            apart = 0.0 if field == "digest" else _apart(before.get(field), now.get(field))
            self.largest = max(self.largest, apart)
            if apart > (0.0 if self.exact else ALIKE):
                return field, before.get(field), now.get(field)
        return None

    def same(self, kind: str) -> bool:
        """Count one that is the same. Return True."""
        self.of[kind] += 1
        self.alike[kind] += 1
        return True

    def different(
        self, kind: str, number: int, time_ns: int, field: str, recorded: Any, replayed: Any
    ) -> bool:
        """Count one that is not, and keep it if it is the first. Return False."""
        self.of[kind] += 1
        if self.first is None:
            self.first = Difference(kind, number, time_ns, field, recorded, replayed)
        return False


@cache
def _decoder(kind: Any) -> Callable[[bytes], Values] | None:
    return decoder(format_of(kind))


def _flat(message: Any) -> Values:
    made = _decoder(message.__class__)
    assert made is not None
    return made(message.SerializeToString())


def _apart(before: Any, now: Any) -> float:
    """How far two values are apart: infinitely, where they are no numbers and not the same."""
    if isinstance(before, float) and isinstance(now, float):
        if math.isnan(before) and math.isnan(now):
            return 0.0
        return abs(before - now) if math.isfinite(before - now) else math.inf
    return 0.0 if before == now else math.inf


def _stamp(message: Any) -> int:
    if isinstance(message, own.LookMessage):
        return int(message.time_ns)
    if isinstance(message, own.CameraErrorsMessage):
        return int(message.captures_ns[-1]) if message.captures_ns else 0
    return int(message.capture_ns)


def _as_text(value: Any) -> str:
    return "nothing" if value is None else repr(value)
