"""The little plant behind the page's coupler: cycles, echo and motion watchdog, no hydraulics."""

from tests.conformance.coupler.rules import MS, Rules

CYCLE_MS = 5
RESET_BIT = 0x0002


class PagePlant:
    """Inputs of clause 10.4 of docs/protocol.md, after the valve images that acted."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._echo = 0
        self._seen = False
        self._held = 0
        self._fresh_ns = 0
        self._tripped = False

    def take(self, image: list[int], now_ns: int) -> None:
        """A valve image acts."""
        self._look(now_ns)
        if not any(image) and not self._rules.takes_zeros:
            return
        cycle, control = image[0], image[1]
        if not self._seen or cycle != self._echo or "write" in self._rules.trip_is_cleared_by:
            self._fresh_ns = now_ns
        edge = control & RESET_BIT and not self._held & RESET_BIT
        if (
            (edge and "edge" in self._rules.trip_is_cleared_by)
            or (control & RESET_BIT and "level" in self._rules.trip_is_cleared_by)
            or (cycle != self._echo and "cycle" in self._rules.trip_is_cleared_by)
        ):
            self._tripped, self._fresh_ns = False, now_ns
        self._seen, self._echo, self._held = True, cycle, control

    def coupler_reset(self) -> None:
        """The coupler's own watchdog was reset; none of the plant's business."""
        if "coupler reset" in self._rules.trip_is_cleared_by:
            self._tripped, self._seen = False, False

    def words(self, written_cycle: int, now_ns: int) -> list[int]:
        """The 40 analog inputs; ``written_cycle``: what stands in the output registers."""
        self._look(now_ns)
        rules = self._rules
        cycle = now_ns // (CYCLE_MS * MS) & 0xFFFF if rules.cycles else 7
        echo = {"whole": self._echo, "written": written_cycle, "frozen": 9, "late": self._echo - 1 & 0xFFFF}
        status = 0b0001 | (rules.tripped_bit if self._tripped else 0)
        inputs = [cycle, rules.layout, echo[rules.echo], status, *range(100, 127), *[rules.reserved] * 8]
        return [*inputs, cycle ^ rules.last_word_apart]

    def _look(self, now_ns: int) -> None:
        if self._seen and now_ns - self._fresh_ns > self._rules.motion_ms * MS:
            self._tripped = True
