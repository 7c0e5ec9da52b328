"""Owner, watchdog and little plant of the page's coupler, by rules.

docs/process_image.md, clauses 4 and 5; docs/protocol.md, 10.4.
"""

from tests.conformance.coupler.rules import MS, RESET, TIME, Rules


class PageWatchdog:
    """Who owns the outputs, and until when the owner has time. Masters are any objects."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.time_ms, self.trigger = 1000, 1
        self.expired = self.armed = False
        self.shown_word = 0
        self.last_owner: object = None
        self._owner: object = None
        self._written_ns = self._fed_ns = 0
        self._begun: object = None
        self._seen: set[int] = set()

    def expires(self, now_ns: int) -> bool:
        """Whether it expires now; true once."""
        if not self.armed or now_ns < self._fed_ns + self.rules.time_ns(self.time_ms):
            return False
        self.armed, self.expired = False, True
        self.last_owner = self._owner
        if "expiry" in self.rules.released_by:
            self._owner = None
        self._forget("expiry")
        return True

    def left(self, now_ns: int) -> int:
        """What the register of the time left shows."""
        if not self.armed:
            return self.rules.left_when_inactive
        return self.rules.left_ms(self._fed_ns + self.rules.time_ns(self.time_ms) - now_ns, self.time_ms)

    def is_owned_by_another(self, master: object, now_ns: int) -> bool:
        """Whether another master owns the outputs."""
        if self._owner is None or self._owner is master:
            return False
        silent = now_ns - self._written_ns >= self.rules.release_ms * MS
        return not (silent and "silence" in self.rules.released_by)

    def carried_out(self, master: object, kind: str, now_ns: int) -> None:
        """A telegram was carried out."""
        rules = self.rules
        function = int(kind.split()[0])
        if kind in rules.arming and self.time_ms > rules.off_up_to_ms and not self.expired:
            if not self.armed:
                self._fed_ns = now_ns
            self.armed = True
        if kind in rules.cleared_by:
            self.expired = False
        if "own" not in kind and function in rules.owning:
            self._owner, self._written_ns = master, now_ns
        if self._owner is master and rules.release_counts_reads:
            self._written_ns = now_ns
        feeding = rules.feeding.get(self.trigger, frozenset())
        if kind in (feeding if self._owner is master else rules.feeding_of_others):
            self._fed_ns = now_ns
        if rules.spoiled_by_requests and not (function in (6, 16) and "own" in kind):
            self._begun = None

    def refused(self, master: object, code: int, now_ns: int) -> None:
        """A telegram was refused."""
        kind = f"refused {code}"
        if kind in self.rules.arming and self.time_ms and not self.expired:
            self.armed, self._fed_ns = True, now_ns
        if kind in self.rules.feeding.get(self.trigger, frozenset()) and self._owner is master:
            self._fed_ns = now_ns
        if kind in self.rules.feeding_of_others and self._owner is not master:
            self._fed_ns = now_ns
        if kind in self.rules.cleared_by:
            self.expired = False
        if code == 6 and self.rules.refused_changes_owner:
            self._owner = master

    def closed(self, master: object, now_ns: int) -> None:
        """A connection has ended."""
        if "close" in self.rules.cleared_by:
            self.expired = False
        if self._owner is master:
            if self.rules.closing == "stops":
                self.armed = False
            if self.rules.closing == "restarts":
                self._fed_ns = now_ns
            if self.rules.closing == "expires" and self.armed:
                self._fed_ns = now_ns - self.rules.time_ns(self.time_ms)
            if "close" in self.rules.released_by:
                self._owner = None
            self._forget("close")
        if self._begun is master and self.rules.of_one_master:
            self._begun = None

    def value_refusal(self, master: object, address: int, word: int) -> int:
        """The exception that a word for one of the own registers deserves, or 0."""
        if address == RESET:
            return self._reset_refusal(master, word)
        if address == TIME:
            if self.expired:
                return self.rules.time_when_expired
            return self.rules.time_when_active if self.armed else 0
        return 0 if word in self.rules.triggers else 3

    def configure(self, master: object, address: int, word: int, now_ns: int) -> bool:
        """Takes a word that is in order; whether that was a reset."""
        if address == TIME:
            self.time_ms = word
        elif address != RESET:
            self.trigger = word
        else:
            return self._reset(master, word)
        return False

    def _reset_refusal(self, master: object, word: int) -> int:
        rules = self.rules
        first, second = rules.reset_words
        begun = self._begun is master or (not rules.of_one_master and self._begun is not None)
        self._seen.add(word)
        if "any order" in rules.reset_by and self._seen >= {first, second}:
            return 0
        if word == first and (rules.begins_anew or not begun):
            return 0
        if word == second and (begun or "second" in rules.reset_by):
            return 0
        if rules.spoiled_by_words and (begun or rules.spoiled_by_others):
            self._begun = None
        return rules.other_word

    def _reset(self, master: object, word: int) -> bool:
        rules = self.rules
        first, second = rules.reset_words
        if rules.reads_the_last:
            self.shown_word = word
        done = (word == second) or (word == first and "first" in rules.reset_by)
        if "any order" in rules.reset_by and self._seen >= {first, second}:
            done = True
        if not done:
            if self._begun is None or rules.spoiled_by_others or self._begun is master:
                self._begun = master
            return False
        self._seen = set()
        if rules.forgets_the_first:
            self._begun = None
        self.expired = self.expired and "latch" not in rules.reset_clears
        self.armed = self.armed and "armed" not in rules.reset_clears
        if "reset" in rules.released_by:
            self._owner = None
        self._forget("reset")
        return True

    def _forget(self, moment: str) -> None:
        if (moment, "time") in self.rules.forgotten:
            self.time_ms = 1000
        if (moment, "trigger") in self.rules.forgotten:
            self.trigger = 1


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
        inputs = [
            cycle,
            rules.layout,
            echo[rules.echo],
            status,
            *range(0x8100, 0x811B),
            *[rules.reserved] * 8,
        ]
        return [*inputs, cycle ^ rules.last_word_apart]

    def _look(self, now_ns: int) -> None:
        if self._seen and now_ns - self._fresh_ns > self._rules.motion_ms * MS:
            self._tripped = True
