"""Cases of what may stay from the request before: each behind each other one, over codes and quantities."""

from collections.abc import Iterator
from functools import partial
from itertools import product

from conformance.case import coupler
from conformance.coupler.steps import Ask, Fresh, Left, Step, Until
from conformance.coupler.table import (
    ALIVE,
    EXPIRED,
    LEFT,
    OWN_READS,
    PLANT_STATUS,
    READS,
    REFUSALS,
    RUNNING,
    STATUS,
    WRITE,
    WRITES,
    play,
    trip,
)

CLEAR, REQUESTS, EXCEPTIONS = "08 000A 0000", "08 000B 0000", "08 000D 0000"
MOST_WORDS, COILS = 125, 16
SHORT_MS = (*range(1, 21), 31, 32, 33, 63, 64, 65, 99)
# Read a word, as it is asked for at an address, and before the word in the answer.
READ_WORD = {"03": "{at} 0001", "04": "{at} 0001", "17": "{at} 0001 {{spare}} 0001 02 0000"}
READ_BACK = {"01 0000 0010": "0102{low}{high}", "03 {{spare}} 0001": "0302{high}{low}",
             "17 {{spare}} 0001 0800 0001 02 0000": "1702{high}{low}"}  # fmt: skip
WRITE_BACK = ("06 {{spare}} {high}{low}", "10 {{spare}} 0001 02 {high}{low}", "0F 0000 0010 02 {low}{high}",
              "17 1000 0007 {{spare}} 0001 02 {high}{low}")  # fmt: skip


def counted(pdu: str, answer: str, exceptions: int, by: str = "a") -> list[Step]:
    """The counters begin at 0, and behind ``pdu`` they hold it."""
    return [Ask(CLEAR), Ask(pdu, answer, by), Ask(REQUESTS, "08 000B 0002"),
            Ask(EXCEPTIONS, f"08 000D {exceptions:04x}")]  # fmt: skip


def _counts() -> Iterator[Step]:
    for count in range(1, MOST_WORDS + 1):
        yield Ask("08 0000" + "".join(f"{257 * n & 0xFFFF:04x}" for n in range(1, count + 1)), "=")
    for pdu in (*READS, *OWN_READS):
        yield from counted(pdu, "ok", 0)
    for pdu, answer in (*REFUSALS[:6], ("00", "!1"), ("7F 0000 0001", "!1"), ("08 000B 0001", "!3")):
        yield from counted(pdu, answer, 1)


def _counts_of_writes() -> Iterator[Step]:
    yield from (Fresh(100, 0), Ask(WRITE))
    for pdu in WRITES:
        yield from counted(pdu, "!6", 1, "b")
    for pdu, answer in REFUSALS:
        yield from counted(pdu, answer, 1)
    yield Ask(STATUS, EXPIRED, wait_ms=150)
    for pdu in (*READS, *WRITES, "06 1120 0001"):
        yield from counted(pdu, "!4", 1)


def _behind_each_other() -> Iterator[Step]:
    yield Fresh(5000)
    before = (*READS, *OWN_READS, *(pdu for pdu, _ in REFUSALS))
    for n, (first, write, read) in enumerate(product(before, WRITE_BACK, READ_BACK.items())):
        word = {"high": f"{n * 37 & 0xFF:02x}", "low": f"{n * 101 & 0xFF:02x}"}
        yield from (Ask(first, ".*"), Ask(write.format(**word)))
        yield Ask(read[0].format(), read[1].format(**word))
    for count, begin in product(range(1, COILS + 1), range(COILS)):
        if begin + count <= COILS:
            size, bits = (count + 7) // 8, (1 << count) - 1 << begin
            yield Ask("06 {spare} 0000")
            yield Ask(f"0F {begin:04x} {count:04x} {size:02x}" + "FF" * size, "=5")
            yield Ask("03 {spare} 0001", f"0302{bits:04x}")
            yield Ask(
                f"01 {begin:04x} {count:04x}",
                f"01{size:02x}" + (bits >> begin).to_bytes(size, "little").hex(),
            )


def _short_times() -> Iterator[Step]:
    for time_ms in SHORT_MS:
        yield from (
            Fresh(1000, 0),
            Ask(f"06 1120 {time_ms:04x}", "="),
            Ask("03 1120 0001", f"0302{time_ms:04x}"),
        )
        yield from (Ask(WRITE, mark=True), Left(LEFT, time_ms), Until(STATUS, EXPIRED, time_ms))
    for time_ms in (*(1 << bit for bit in range(7, 16)), 0x7FFF, 0xFFFF):
        yield from (Fresh(time_ms, 0), Ask("03 1120 0001", f"0302{time_ms:04x}"))
        yield from (Ask(WRITE, mark=True), Left(LEFT, time_ms), Ask(STATUS, ALIVE))


def _of_now() -> Iterator[Step]:
    yield Fresh(5000)
    yield Ask("03 0000 0001", keep="cycle")
    for code in (code for pair in product(READ_WORD, repeat=2) for code in pair):
        pdu = f"{code} {READ_WORD[code].format(at='0000')}"
        yield Ask(pdu, f"{code}02(?!{{cycle}})....", wait_ms=15, keep="cycle")
    for code in ("02", *READ_WORD):
        at = PLANT_STATUS.split()[1]
        pdu = "02 0000 0008" if code == "02" else f"{code} {READ_WORD[code].format(at=at)}"
        for tripped in (False, True):
            yield from RUNNING if not tripped else ()
            pattern = trip(tripped)[-len("[4-7c-f]") :] if tripped else "[0-389ab]"
            head = "0201." if code == "02" else f"{code}02..."
            yield Ask(pdu, head + pattern, wait_ms=200 if tripped else 0)


for _number, _clause, _title, _steps, _writes, _plant in (
    (
        623,
        "2.6",
        "the echo repeats any length; each exception is counted, and nothing else",
        _counts,
        False,
        False,
    ),
    (
        624,
        "2.6",
        "exceptions of the owner and of the watchdog are counted too",
        _counts_of_writes,
        True,
        False,
    ),
    (
        652,
        "2.7",
        "what is written is read back by each code at once, whatever was asked before",
        _behind_each_other,
        True,
        False,
    ),
    (672, "5.1", "each time is kept as it is set, also one of few ms", _short_times, True, False),
    (
        924,
        "10.6",
        "inputs are of the moment of each request, by whichever code they are read",
        _of_now,
        True,
        True,
    ),
):
    coupler.case(_number, _clause, _title, motion=_writes)(partial(play, [*_steps()], _plant))
