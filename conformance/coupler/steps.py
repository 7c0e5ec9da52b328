"""Steps of a case as data, and what carries them out.

Requests are PDUs in hexadecimal. Answers are regular expressions on the PDU in hexadecimal; ``ok``: carried
out; ``=``: the request itself, ``=5``: its first five bytes; ``!4``: exception 4. ``{name}`` stands for what
the coupler says of itself (``names_of``) and for what an earlier step has kept.
"""

import re
import time
from collections.abc import Sequence
from typing import NamedTuple

from conformance.master import INPUTS, OUTPUTS, Master
from conformance.wire import Unsupported, require
from protocol.coupler_registers import WATCHDOG_DEFAULT_MS
from protocol.process_image import INPUT_LAYOUT, INPUT_WORDS, OUTPUT_WORDS

EARLY_MS, LATE_MS = 5.0, 50.0  # on the tester's clock
LOOK_EACH_MS = 5.0
_LOOK_BEFORE_MS = 30.0
_WITHIN_A_PIECE_S = 0.002


class Fresh(NamedTuple):
    """Outputs zero, watchdog inactive and set so, other connections closed. The first step of what writes."""

    time_ms: int = WATCHDOG_DEFAULT_MS
    trigger: int = 1


class Ask(NamedTuple):
    """A request of connection ``by``, ``wait_ms`` after the step before.

    ``mark``: the time of ``Until`` and ``Left`` begins with it. ``keep``: the answer's data get this name.
    """

    pdu: str
    answer: str = "ok"
    by: str = "a"
    wait_ms: float = 0.0
    mark: bool = False
    keep: str = ""
    transaction: int | None = None
    unit: int | None = None


class Until(NamedTuple):
    """A request that is repeated until it is answered so, ``at_ms`` after the mark; None: within 50 ms."""

    pdu: str
    answer: str
    at_ms: float | None
    by: str = "b"


class Left(NamedTuple):
    """The word that ``pdu`` reads is what is left of ``time_ms`` since the mark, in ms."""

    pdu: str
    time_ms: int
    wait_ms: float = 0.0


class Send(NamedTuple):
    """Bytes as they are, in pieces; ``answers``: the transactions answered behind them, in order."""

    pieces: tuple[str, ...]
    answers: tuple[int, ...] = ()
    closed: bool = False
    by: str = "a"


class HangUp(NamedTuple):
    """Connection ``by`` is closed."""

    by: str


Step = Fresh | Ask | Until | Left | Send | HangUp


def names_of(master: Master) -> dict[str, str]:
    """What the coupler says of its image: addresses and lengths as words in hexadecimal."""
    lengths = master.lengths()
    ins = lengths.analog_inputs + (lengths.digital_inputs + 15) // 16
    outs = lengths.analog_outputs + (lengths.digital_outputs + 15) // 16
    numbers = {
        "ins": ins, "ins_and_one": ins + 1, "behind_ins": INPUTS + ins,
        "digital_in": INPUTS + lengths.analog_inputs, "outs": outs, "outs_and_one": outs + 1,
        "behind_outs": OUTPUTS + outs, "last_out": OUTPUTS + outs - 1,
        "spare": OUTPUTS + lengths.analog_outputs, "coils": lengths.digital_outputs,
    }  # fmt: skip
    return {name: f"{number:04x}" for name, number in numbers.items()}


def require_this_plant(master: Master) -> None:
    """Raise Unsupported unless both images are those of protocol.md, clause 10."""
    lengths = master.lengths()
    mine = (lengths.analog_inputs, lengths.analog_outputs) == (INPUT_WORDS, OUTPUT_WORDS)
    if not mine or master.word(INPUTS + 1) != INPUT_LAYOUT:
        raise Unsupported("images of another plant")


class Play:
    """Carries out the steps of one case."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._others: dict[str, Master] = {}
        self._earliest_ms, self._latest_ms = 0.0, 0.0  # of the mark, on the tester's clock
        self._names: dict[str, str] = {}

    def run(self, steps: Sequence[Step]) -> None:
        """Raise Failed at the first step that is answered otherwise; Unsupported."""
        if "{" in repr(steps) and not isinstance(steps[0], Fresh):
            self._names = names_of(self._master)
        for step in steps:
            match step:
                case Fresh():
                    self._freshen(step)
                case Ask():
                    _wait(step.wait_ms)
                    self._ask(step)
                case Until():
                    self._until(step)
                case Left():
                    self._left(step)
                case Send():
                    self._send(step)
                case HangUp():
                    self._others.pop(step.by).hang_up()

    def _by(self, name: str) -> Master:
        if name == "a":
            return self._master
        if name not in self._others:
            self._others[name] = self._master.second()
        return self._others[name]

    def _freshen(self, step: Fresh) -> None:
        for other in self._others.values():
            other.hang_up()
        self._others.clear()
        lengths = self._master.take_outputs(step.time_ms, step.trigger)
        if lengths.digital_outputs < 16:
            raise Unsupported("fewer than 16 digital outputs")
        self._names |= names_of(self._master)

    def _bytes(self, text: str) -> bytes:
        return bytes.fromhex(text.format_map(self._names))

    def _pattern(self, answer: str, pdu: bytes) -> str:
        if answer == "ok":
            return f"{pdu[0]:02x}.*"
        if answer.startswith("!"):
            return f"{pdu[0] | 0x80:02x}0{answer[1]}"
        if answer.startswith("="):
            return pdu[: int(answer[1:] or len(pdu))].hex()
        return answer.replace(" ", "").format_map(self._names).lower()

    def _ask(self, step: Ask) -> None:
        pdu = self._bytes(step.pdu)
        began_ms = _now_ms()
        answer = self._by(step.by).ask(pdu, transaction=step.transaction, unit=step.unit)
        if step.mark:
            self._earliest_ms, self._latest_ms = began_ms, _now_ms()
        pattern = self._pattern(step.answer, pdu)
        require(
            re.fullmatch(pattern, answer.hex()) is not None,
            f"{step.by}: {pdu.hex()} was answered {answer.hex()}, wanted {pattern}",
        )
        if step.keep:
            self._names[step.keep] = answer[2:].hex()

    def _until(self, step: Until) -> None:
        pdu = self._bytes(step.pdu)
        pattern = self._pattern(step.answer, pdu)
        due_ms = 0.0 if step.at_ms is None else step.at_ms
        _wait(self._latest_ms + due_ms - _LOOK_BEFORE_MS - _now_ms())
        while True:
            request_ms = _now_ms()
            answer = self._by(step.by).ask(pdu)
            if re.fullmatch(pattern, answer.hex()):
                early_ms = self._earliest_ms + due_ms - _now_ms()
                require(early_ms <= EARLY_MS, f"{pdu.hex()}: at least {early_ms:.0f} ms before {due_ms:g} ms")
                return
            late_ms = request_ms - self._latest_ms - due_ms
            why = f"{pdu.hex()}: {answer.hex()}, not {pattern}, {late_ms:.0f} ms after {due_ms:g} ms"
            require(late_ms <= LATE_MS, why)
            _wait(LOOK_EACH_MS)

    def _left(self, step: Left) -> None:
        _wait(step.wait_ms)
        pdu, before_ms = self._bytes(step.pdu), _now_ms()
        left_ms = int.from_bytes(self._by("a").done(pdu, "the time left")[2:], "big")
        least = step.time_ms - (_now_ms() - self._earliest_ms) - 1.0  # whole milliseconds
        most = max(min(step.time_ms - (before_ms - self._latest_ms) + 1.0, step.time_ms), 0.0)
        require(least <= left_ms <= most, f"{left_ms} ms left, wanted {least:.1f} to {most:.1f}")

    def _send(self, step: Send) -> None:
        master = self._by(step.by)
        for piece in step.pieces:
            master.send_raw(self._bytes(piece))
            time.sleep(_WITHIN_A_PIECE_S)
        for transaction in step.answers:
            answer = master.receive()
            got = None if answer is None else answer[0]
            require(got == transaction, f"the answer has transaction {got}, wanted {transaction}")
        if step.closed:
            require(master.is_closed(), "the connection lives on, or was answered on")


def _now_ms() -> float:
    return time.monotonic() * 1e3


def _wait(ms: float) -> None:
    time.sleep(max(ms, 0.0) / 1e3)
