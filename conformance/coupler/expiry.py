"""Cases 886…: what expiry does, and what ends it (clauses 5.4 to 5.6)."""

from conformance.case import coupler
from conformance.coupler.frames import (
    ADDRESS,
    FUNCTION,
    LATE_MS,
    VALUE,
    count,
    now_ms,
    require_expiry,
    timed,
    wait,
)
from conformance.coupler.limits import BETWEEN, nowhere_requests
from conformance.coupler.outputs import every_write, spare_word
from conformance.coupler.owners import impossible_writes
from conformance.coupler.registers import OWN
from conformance.coupler.retrigger import SHORT_MS, readings, require_unarmed
from conformance.coupler.watchdog import EXPIRED, let_expire
from conformance.master import (
    INPUTS,
    OUTPUTS,
    READ_HOLDING,
    READ_INPUT,
    Master,
    read_request,
    word_request,
    write_request,
)
from conformance.wire import require
from protocol.coupler_registers import (
    RESET_WORDS,
    STATUS,
    STATUS_FIELDBUS,
    WATCHDOG_LEFT_MS,
    WATCHDOG_RESET,
    WATCHDOG_TIME_MS,
    WATCHDOG_TRIGGER,
)

case = coupler.case
FIRST, SECOND = RESET_WORDS
# The time left is a whole number of milliseconds, rounded either way.
ROUNDED_MS = 1.0


def reset_word(word: int) -> bytes:
    """A request that writes ``watchdog_reset``."""
    return word_request(WATCHDOG_RESET, word)


@case(886, "5.4", "expiry sets every output to zero, analog and digital", motion=True)
def every_output(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    # A torn image, not enabled: it is kept and does not act.
    words = [0x0101, 0x8000, *range(1, spare - OUTPUTS - 1), 0xFFFF]
    master.done(write_request(OUTPUTS, words), "writing every output")
    require(master.words(OUTPUTS, len(words)) == words, "the outputs are not those written")
    wait(SHORT_MS + LATE_MS)
    require(master.expired, f"no expiry {LATE_MS:g} ms after its time")
    master.reset()
    left = master.words(OUTPUTS, len(words))
    require(not any(left), "after expiry the outputs are " + " ".join(f"{word:04x}" for word in left))


@case(887, "5.4", "after expiry every connection is refused with 4, with every function code", motion=True)
def every_connection(master: Master) -> None:
    spare = let_expire(master)
    before, after = master.second(), master.second()
    image = [pdu for pdu in readings(spare) if pdu[0] != 8 and int.from_bytes(pdu[1:3], "big") < 0x1000]
    for each in (before, after, master):
        for pdu in [*image, *every_write(spare), word_request(OUTPUTS, 0)]:
            each.refused(pdu, EXPIRED, f"{pdu.hex()} after expiry")
    master.reset()
    require(not any(master.words(OUTPUTS, spare - OUTPUTS + 1)), "a write that was refused has written")


@case(888, "5.4", "after expiry own registers are read and set, and diagnostics answered", motion=True)
def served_after_expiry(master: Master) -> None:
    let_expire(master)
    for each in (master, master.second()):
        for function in (READ_HOLDING, READ_INPUT):
            for address in OWN:
                each.words(address, 1, function)
        for sub in (0, 2, 11, 12, 13, 14, 10):
            each.done(bytes([8, 0, sub, 0, 0]), f"sub-function {sub}")
        each.done(word_request(WATCHDOG_TRIGGER, 1), "setting the trigger")


@case(
    889,
    "3.3",
    "expiry sets bit 15 of the status and neither of the others, also in the diagnostics",
    motion=True,
)
def status_bits(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    for expected in (0, STATUS_FIELDBUS, 0):
        got, diagnostics = master.word(STATUS), count(master, 2)
        require(
            got & 0x8003 == expected and diagnostics == got,
            f"status {got:#06x}, diagnostics {diagnostics:#06x}",
        )
        if expected == 0:
            master.done(word_request(spare, 1), "a write")
            wait(SHORT_MS + LATE_MS)
        else:
            master.reset()


@case(
    890, "5.4", "nothing but a reset ends it: no time, no telegram, no closed or new connection", motion=True
)
def latched(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    owner = master.second()
    owner.done(word_request(spare, 1), "the owner's write")
    wait(SHORT_MS + LATE_MS)
    counters = [bytes([8, 0, sub, 0, 0]) for sub in (10, 11)]
    settings = [word_request(WATCHDOG_TRIGGER, 1), word_request(WATCHDOG_TIME_MS, 1000)]
    for pdu in [*readings(spare), *every_write(spare), *counters, b"\x07", *settings]:
        owner.ask(pdu)
        require(master.expired, f"{pdu.hex()} ended it")
    owner.hang_up()
    wait(5 * SHORT_MS)
    require(master.second().expired, "it ended by itself, or with its owner's connection")


@case(891, "2.2", "after expiry a wrong function code, length or address is told first", motion=True)
def order_after_expiry(master: Master) -> None:
    let_expire(master)
    master.refused(b"\x07", FUNCTION, "a function code that is not listed")
    for pdu in nowhere_requests(BETWEEN).values():
        master.refused(pdu, ADDRESS, f"function code {pdu[0]} where nothing is")
        master.refused(pdu + b"\0", VALUE, f"function code {pdu[0]}, too long")
    master.refused(read_request(READ_HOLDING, INPUTS, 0), VALUE, "nothing to read")


@case(892, "2.2", "after expiry 4 is told before what is wrong with a value", motion=True)
def expiry_before_value(master: Master) -> None:
    spare = let_expire(master)
    if spare - OUTPUTS == 12:
        for pdu in impossible_writes():
            master.refused(pdu, EXPIRED, f"a spool command of -32768 with {pdu[0]}")
    master.refused(word_request(WATCHDOG_TRIGGER, 2), VALUE, "a trigger of 2: own registers are served")


@case(893, "5.1", "after expiry the time cannot be set until the reset: 4", motion=True)
def time_after_expiry(master: Master) -> None:
    let_expire(master)
    kept = master.word(WATCHDOG_TIME_MS)
    for pdu in (word_request(WATCHDOG_TIME_MS, 777), write_request(WATCHDOG_TIME_MS, [777])):
        master.refused(pdu, EXPIRED, "setting the time of an expired watchdog")
    require(master.word(WATCHDOG_TIME_MS) == kept, "the time changed")
    master.reset()
    master.done(word_request(WATCHDOG_TIME_MS, 777), "setting the time after the reset")
    require(master.word(WATCHDOG_TIME_MS) == 777, "the time did not change")


@case(
    894,
    "5.5",
    "time and trigger stay as they were set, through expiry, reset and a new connection",
    motion=True,
)
def settings_stay(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS, trigger=0)
    owner = master.second()
    for step in range(2):
        owner.done(word_request(spare, 1), "a write")
        wait(SHORT_MS + LATE_MS)
        other = master.second()
        other.reset()
        got = (other.word(WATCHDOG_TIME_MS), other.word(WATCHDOG_TRIGGER))
        require(got == (SHORT_MS, 0), f"after expiry and reset {step + 1}: time and trigger are {got}")
    owner.done(word_request(spare, 1), "a write")
    owner.hang_up()
    wait(20)
    got = (master.word(WATCHDOG_TIME_MS), master.word(WATCHDOG_TRIGGER))
    require(got == (SHORT_MS, 0), f"after the owner has hung up: time and trigger are {got}")


@case(895, "5.5", "the first word begins anew: given twice, then the second, it resets", motion=True)
def first_word_twice(master: Master) -> None:
    let_expire(master)
    for word in (FIRST, FIRST, SECOND):
        master.done(reset_word(word), f"reset word {word:#06x}")
    require(not master.expired, "it was not reset")


@case(896, "5.5", "requests between the two words that give no other word there spoil nothing", motion=True)
def requests_between(master: Master) -> None:
    spare = let_expire(master)
    master.done(reset_word(FIRST), "the first reset word")
    for pdu in [*readings(spare), *every_write(spare), word_request(WATCHDOG_TRIGGER, 1), b"\x07"]:
        master.ask(pdu)
    master.second().word(WATCHDOG_RESET)
    master.done(reset_word(SECOND), "the second reset word")
    require(not master.expired, "it was not reset")


@case(897, "5.5", "a word of another master between the two spoils the reset", motion=True)
def a_stranger_between(master: Master) -> None:
    let_expire(master)
    for word in (FIRST, 0x0000, 0x1234):
        master.done(reset_word(FIRST), "the first reset word")
        master.second().ask(reset_word(word))
        master.refused(reset_word(SECOND), VALUE, f"the second word after another master's {word:#06x}")
        require(master.expired, "it was reset")


@case(
    898,
    "5.5",
    "each pair resets once, and what is spoiled can be begun again, with 6 or with 16",
    motion=True,
)
def pairs(master: Master) -> None:
    for make in (reset_word, lambda word: write_request(WATCHDOG_RESET, [word])):
        let_expire(master)
        master.done(make(FIRST), "the first word")
        master.refused(make(0x0000), VALUE, "no reset word")
        master.refused(make(SECOND), VALUE, "the second word after a spoiled first one")
        require(master.expired, "it was reset")
        master.done(make(FIRST), "the first word")
        master.done(make(SECOND), "the second word")
        require(not master.expired, "it was not reset")
        master.refused(make(SECOND), VALUE, "the second word again")


@case(899, "5.5", "a reset makes an armed watchdog inactive and leaves the outputs as they are", motion=True)
def reset_while_armed(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    master.done(word_request(spare, 0x1234), "a write")
    master.reset()
    require_unarmed(master, "the write before the reset still")
    wait(SHORT_MS + LATE_MS)
    require(not master.expired, "it expired after its reset")
    require(master.word(spare) == 0x1234, "the reset has changed an output")
    fed = timed(master, word_request(spare, 1), "a write")
    require_expiry(master.second(), fed, SHORT_MS, "the write after the reset")


@case(
    900,
    "5.5",
    "words beside the two are refused with 3, and the register reads the last that was taken",
    motion=True,
)
def words_beside(master: Master) -> None:
    let_expire(master)
    for word in (FIRST - 1, FIRST + 1, SECOND - 1, SECOND + 1, FIRST ^ 0x8000, 0xCFBE, 0xFEAF):
        master.refused(reset_word(word), VALUE, f"{word:#06x}")
        master.refused(reset_word(SECOND), VALUE, "the second word after it")
    require(master.expired, "it was reset")
    for word in (FIRST, SECOND, FIRST):
        master.done(reset_word(word), f"reset word {word:#06x}")
        master.ask(reset_word(0x0000)) if word == SECOND else None
        got = master.word(WATCHDOG_RESET)
        require(got == word, f"the register reads {got:#06x}, the last word taken is {word:#06x}")


@case(901, "5.6", "the time left is what is left, within 1 ms, and 0 while it is inactive", motion=True)
def time_left(master: Master) -> None:
    for time_ms in (SHORT_MS, 3000, 60_000):
        spare = spare_word(master, watchdog_ms=time_ms, trigger=0)
        require_unarmed(master, "no write")
        fed = timed(master, word_request(spare, 1), "a write")
        for _ in range(4):
            before_ms = now_ms()
            left_ms = master.word(WATCHDOG_LEFT_MS)
            least = time_ms - (now_ms() - fed.earliest_ms) - ROUNDED_MS
            most = time_ms - (before_ms - fed.latest_ms) + ROUNDED_MS
            require(
                least <= left_ms <= min(most, time_ms), f"{left_ms} ms left: wanted {least:.1f} to {most:.1f}"
            )
            wait(0.2 * SHORT_MS)
        master.reset()
        require_unarmed(master, "the write before the reset still")
