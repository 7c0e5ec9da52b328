"""Cases 861…: whose the outputs are, and since when no longer (clause 4)."""

from conformance.case import coupler
from conformance.coupler.frames import (
    ADDRESS,
    FUNCTION,
    LATE_MS,
    LOOK_EACH_MS,
    STEP_MS,
    VALUE,
    Moment,
    now_ms,
    timed,
    wait,
    wait_until,
)
from conformance.coupler.limits import BETWEEN, nowhere_requests
from conformance.coupler.outputs import OWNED, every_write, spare_word
from conformance.coupler.registers import OWN
from conformance.master import (
    INPUTS,
    OUTPUTS,
    READ_COILS,
    READ_DISCRETE,
    READ_HOLDING,
    READ_INPUT,
    Master,
    exchange_request,
    read_request,
    word_request,
    write_request,
)
from conformance.wire import require
from protocol.coupler_registers import RESET_WORDS, WATCHDOG_RESET, WATCHDOG_TIME_MS, WATCHDOG_TRIGGER

case = coupler.case
RELEASE_MS = 1000
READING = (READ_COILS, READ_DISCRETE, READ_HOLDING, READ_INPUT)


def require_refused_writes(other: Master, spare: int) -> None:
    """Raises Failed unless every write of another master is refused with 6."""
    for pdu in every_write(spare):
        other.refused(pdu, OWNED, f"function code {pdu[0]} of another master")


@case(861, "4.1", "each writing function code makes its connection the owner", motion=True)
def every_write_owns(master: Master) -> None:
    spare = spare_word(master)
    other = master.second()
    for pdu in every_write(spare):
        master.done(pdu, f"function code {pdu[0]}")
        require_refused_writes(other, spare)
        master.reset()


@case(862, "4.1", "the owner of one output owns all of them", motion=True)
def all_outputs(master: Master) -> None:
    spare = spare_word(master)
    other = master.second()
    for pdu in (word_request(spare, 1), word_request(OUTPUTS, 0), bytes.fromhex("05 0000 FF00")):
        master.done(pdu, "the owner's write")
        for address in (OUTPUTS, spare - 1, spare):
            other.refused(word_request(address, 0), OWNED, f"{address:#06x} with 6")
            other.refused(write_request(address, [0]), OWNED, f"{address:#06x} with 16")
            other.refused(exchange_request(INPUTS, 1, address, [0]), OWNED, f"{address:#06x} with 23")
        other.refused(bytes.fromhex("05 000F 0000"), OWNED, "the last coil with 5")
        other.refused(bytes.fromhex("0F 0008 0008 01 00"), OWNED, "the last coils with 15")
        master.reset()


@case(
    863, "4.2", "another master reads everything and asks the diagnostics, and changes no owner", motion=True
)
def reading_is_free(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 0x0F0F), "the owner's write")
    other = master.second()
    for function in READING:
        other.done(read_request(function, 0, 1), f"function code {function}")
    for address in (OUTPUTS, spare, *OWN):
        other.word(address)
    other.done(bytes.fromhex("08 000B 0000"), "diagnostics")
    require_refused_writes(other, spare)
    require(master.word(spare) == 0x0F0F, "the outputs have changed")
    master.done(word_request(spare, 1), "the owner's write after it")


@case(864, "4.2", "another master writes none of the watchdog's registers, with 6 or 16: 6", motion=True)
def others_settings(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 1), "the owner's write")
    kept = master.words(WATCHDOG_TIME_MS, 3)
    other = master.second()
    for address, word in (
        (WATCHDOG_TRIGGER, 0), (WATCHDOG_TRIGGER, 1), *((WATCHDOG_RESET, each) for each in RESET_WORDS),
        (WATCHDOG_TIME_MS, 5),
    ):  # fmt: skip
        other.refused(word_request(address, word), OWNED, f"{address:#06x} with 6")
        other.refused(write_request(address, [word]), OWNED, f"{address:#06x} with 16")
    require(master.words(WATCHDOG_TIME_MS, 3) == kept, "a refused master has changed one")


@case(865, "2.2", "what is wrong with a stranger's request is told before whose the outputs are", motion=True)
def order_for_strangers(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 1), "the owner's write")
    other = master.second()
    other.refused(b"\x07", FUNCTION, "a function code that is not listed")
    for pdu in nowhere_requests(BETWEEN).values():
        other.refused(pdu, ADDRESS, f"function code {pdu[0]} where nothing is")
    for pdu in every_write(spare):
        other.refused(pdu + b"\0", VALUE, f"function code {pdu[0]}, too long")
    other.refused(exchange_request(0x7000, 1, spare, [1]), ADDRESS, "an exchange that reads where nothing is")


@case(866, "2.2", "whose the outputs are is told before what is wrong with a value", motion=True)
def owner_before_value(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 1), "the owner's write")
    other = master.second()
    for address, word in ((WATCHDOG_TRIGGER, 2), (WATCHDOG_RESET, 0x1234), (WATCHDOG_TIME_MS, 5)):
        other.refused(word_request(address, word), OWNED, f"{word:#06x} in {address:#06x}")
    if spare - OUTPUTS == 12:
        for pdu in impossible_writes():
            other.refused(pdu, OWNED, f"a spool command of -32768 with {pdu[0]}")


def impossible_writes() -> list[bytes]:
    """A spool command of -32768 with each function code that can carry one."""
    spool = OUTPUTS + 2
    words = [0x8000]
    return [
        word_request(spool, *words),
        write_request(spool, words),
        exchange_request(INPUTS, 1, spool, words),
    ]


@case(867, "4.3", "after a reset of the watchdog another master may write at once", motion=True)
def released_by_reset(master: Master) -> None:
    spare = spare_word(master)
    other = master.second()
    master.done(word_request(spare, 1), "the owner's write")
    other.refused(word_request(spare, 2), OWNED, "another master before the reset")
    master.reset()
    other.done(word_request(spare, 2), "another master after the reset")
    master.refused(word_request(spare, 3), OWNED, "the owner of before")


def require_release(other: Master, spare: int, written: Moment, why: str) -> None:
    """Raises Failed unless another master gets the outputs RELEASE_MS after the owner's last write.

    Slack: STEP_MS early, LATE_MS late.
    """
    wait_until(written.latest_ms + RELEASE_MS - 30.0)
    while True:
        asked_ms = now_ms()
        taken = other.ask(word_request(spare, 0x7777))[0] == 6
        if taken:
            early_ms = written.earliest_ms + RELEASE_MS - now_ms()
            require(early_ms <= STEP_MS, f"{why}: released {early_ms:.0f} ms before {RELEASE_MS} ms")
            return
        late_ms = asked_ms - written.latest_ms - RELEASE_MS
        require(late_ms <= LATE_MS, f"{why}: not released {late_ms:.0f} ms after {RELEASE_MS} ms")
        wait(LOOK_EACH_MS)


@case(
    868, "4.3", "an owner that writes no more is followed after 1000 ms, also when it reads on", motion=True
)
def released_by_silence(master: Master) -> None:
    for watchdog_ms in (0, 5000):
        spare = spare_word(master, watchdog_ms=watchdog_ms)
        written = timed(master, word_request(spare, 1), "the owner's write")
        other = master.second()
        other.refused(word_request(spare, 2), OWNED, "another master right after it")
        for _ in range(3):
            wait(250)
            master.words(INPUTS, 1)
            other.refused(word_request(spare, 2), OWNED, "another master meanwhile")
        require_release(other, spare, written, f"with a watchdog of {watchdog_ms} ms")
        master.refused(word_request(spare, 3), OWNED, "the owner of before")
        other.reset()
        other.hang_up()


@case(869, "4.3", "an owner that writes again keeps the outputs for 1000 ms from then on", motion=True)
def kept_by_writing(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=0)
    other = master.second()
    for _ in range(3):
        written = timed(master, word_request(spare, 1), "the owner's write")
        wait(700)
        other.refused(word_request(spare, 2), OWNED, "another master between the owner's writes")
    require_release(other, spare, written, "after the last of three writes")


@case(870, "4.3", "a second master that hangs up leaves the owner its outputs", motion=True)
def a_stranger_leaves(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 1), "the owner's write")
    stranger = master.second()
    stranger.refused(word_request(spare, 2), OWNED, "a second master")
    stranger.hang_up()
    wait(20)
    require_refused_writes(master.second(), spare)
    master.done(word_request(spare, 3), "the owner's write after it")
