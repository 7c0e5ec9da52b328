"""Cases 871…: what arms the watchdog, what retriggers it, and when it expires (clauses 5.1 to 5.3, 5.7).

Slack of every time here: 5 ms early, 50 ms late, on the tester's clock.
"""

from conformance.case import coupler
from conformance.coupler.frames import (
    ADDRESS,
    FUNCTION,
    LATE_MS,
    VALUE,
    Moment,
    require_alive,
    require_expiry,
    timed,
    wait,
)
from conformance.coupler.outputs import OWNED, coil_request, every_write, spare_word
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
from protocol.coupler_registers import IDENTIFICATION, WATCHDOG_LEFT_MS, WATCHDOG_TRIGGER

case = coupler.case
SHORT_MS = 200


def readings(spare: int) -> list[bytes]:
    """Requests that write nothing: each function code, on the image and on own registers, and diagnostics."""
    return [
        read_request(READ_COILS, 0, 1),
        read_request(READ_DISCRETE, 0, 1),
        read_request(READ_HOLDING, INPUTS, 1),
        read_request(READ_HOLDING, spare, 1),
        read_request(READ_INPUT, INPUTS, 1),
        read_request(READ_HOLDING, IDENTIFICATION, 1),
        read_request(READ_INPUT, IDENTIFICATION, 1),
        bytes.fromhex("08 0000 1234"),
    ]


def settings(trigger: int) -> list[bytes]:
    """Writes to own registers, with each function code."""
    return [word_request(WATCHDOG_TRIGGER, trigger), write_request(WATCHDOG_TRIGGER, [trigger])]


def refusals(spare: int) -> list[tuple[bytes, int]]:
    """Requests of every function code that deserve an exception, and which."""
    return [
        (b"\x07", FUNCTION),
        (bytes.fromhex("08 0063 0000"), FUNCTION),
        (read_request(READ_HOLDING, INPUTS, 0), VALUE),
        (read_request(READ_INPUT, 0x7000, 1), ADDRESS),
        (read_request(READ_COILS, 0xFFFF, 1), ADDRESS),
        (word_request(0x0900, 0), ADDRESS),
        (coil_request(1, 0x1234), VALUE),
        (write_request(spare + 1, [1]), ADDRESS),
        (exchange_request(0x7000, 1, spare, [1]), ADDRESS),
        (word_request(WATCHDOG_TRIGGER, 2), VALUE),
    ]


def require_unarmed(master: Master, what: str) -> None:
    """Raises Failed when time is running."""
    require(master.word(WATCHDOG_LEFT_MS) == 0, f"{what} armed the watchdog")


@case(
    871, "5.3", "it expires when its time has passed since the write, neither before nor after", motion=True
)
def in_its_time(master: Master) -> None:
    for time_ms in (1, 100, SHORT_MS, 1000):
        spare = spare_word(master, watchdog_ms=time_ms, trigger=0)
        fed = timed(master, word_request(spare, 1), "the write")
        require_expiry(master.second(), fed, time_ms, f"a watchdog of {time_ms} ms")


@case(872, "5.3", "its time begins anew with every write", motion=True)
def anew(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS, trigger=0)
    for _ in range(4):
        fed = timed(master, word_request(spare, 1), "a write")
        wait(0.7 * SHORT_MS)
    require_expiry(master.second(), fed, SHORT_MS, "after the last of four writes")


@case(873, "5.2", "no reading, no diagnostics and no setting arms it", motion=True)
def unarmed_by_readings(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    for pdu in [*readings(spare), *settings(0), *settings(1)]:
        master.done(pdu, pdu.hex())
        require_unarmed(master, pdu.hex())
    wait(SHORT_MS + LATE_MS)
    require(not master.expired, "it expired without a write")


@case(874, "5.2", "no refused request arms it", motion=True)
def unarmed_by_refusals(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    for pdu, code in refusals(spare):
        master.refused(pdu, code, pdu.hex())
        require_unarmed(master, f"refused {pdu.hex()}")
    wait(SHORT_MS + LATE_MS)
    require(not master.expired, "it expired without a write that was carried out")


def fed_by_each(master: Master, trigger: int, requests: list[bytes], *, feeds: bool, why: str) -> None:
    """Raises Failed unless each request of the owner retriggers the watchdog, or unless none does."""
    for pdu in requests:
        spare = spare_word(master, watchdog_ms=SHORT_MS, trigger=trigger)
        owner, observer = master.second(), master.second()
        fed = timed(owner, word_request(spare, 1), "the write")
        wait(0.6 * SHORT_MS)
        again = timed(owner, pdu, pdu.hex())
        require_expiry(observer, again if feeds else fed, SHORT_MS, f"{why}, {pdu.hex()}")
        owner.hang_up()
        observer.hang_up()


@case(875, "5.3", "trigger 1: every telegram of the owner that is carried out retriggers it", motion=True)
def any_telegram(master: Master) -> None:
    spare = spare_word(master)
    requests = [*readings(spare), *settings(1), *every_write(spare)]
    fed_by_each(master, 1, requests, feeds=True, why="trigger 1")


@case(876, "5.3", "trigger 0: writes to outputs retrigger it with every function code", motion=True)
def writes_feed(master: Master) -> None:
    spare = spare_word(master)
    requests = [
        *every_write(spare),
        exchange_request(IDENTIFICATION, 1, spare, [1]),
        word_request(OUTPUTS, 0),
    ]
    fed_by_each(master, 0, requests, feeds=True, why="trigger 0")


@case(877, "5.3", "trigger 0: nothing else of the owner retriggers it", motion=True)
def writes_alone_feed(master: Master) -> None:
    spare = spare_word(master)
    fed_by_each(master, 0, [*readings(spare), *settings(0)], feeds=False, why="trigger 0")


def fed_by_none(master: Master, trigger: int, requests: list[tuple[bytes, int]], *, stranger: bool) -> None:
    """Raises Failed unless each request is answered with its code (0: carried out) and none retriggers."""
    for pdu, code in requests:
        spare = spare_word(master, watchdog_ms=SHORT_MS, trigger=trigger)
        owner, other = master.second(), master.second()
        fed = timed(owner, word_request(spare, 1), "the write")
        wait(0.6 * SHORT_MS)
        asks = other if stranger else owner
        asks.refused(pdu, code, pdu.hex()) if code else asks.done(pdu, pdu.hex())
        require_expiry(other, fed, SHORT_MS, f"trigger {trigger}, {pdu.hex()}")
        owner.hang_up()
        other.hang_up()


@case(878, "5.3", "no refused request of the owner retriggers it, with either trigger", motion=True)
def refusals_feed_nothing(master: Master) -> None:
    spare = spare_word(master)
    for trigger in (0, 1):
        fed_by_none(master, trigger, refusals(spare), stranger=False)


@case(879, "5.3", "no telegram of another master retriggers it, carried out or refused", motion=True)
def strangers_feed_nothing(master: Master) -> None:
    spare = spare_word(master)
    refused = [(pdu, OWNED) for pdu in [*every_write(spare), *settings(1)]]
    fed_by_none(
        master, 1, [(pdu, 0) for pdu in readings(spare)] + refused + refusals(spare)[:3], stranger=True
    )


@case(
    880,
    "5.2",
    "each writing function code arms it, on analog and on digital outputs, to the full time",
    motion=True,
)
def armed_by_each(master: Master) -> None:
    spare = spare_word(master)
    for pdu in [*every_write(spare), word_request(OUTPUTS, 0), write_request(OUTPUTS, [0]),
                exchange_request(INPUTS, 1, OUTPUTS, [0])]:  # fmt: skip
        spare_word(master, watchdog_ms=SHORT_MS, trigger=0)
        owner = master.second()
        fed = timed(owner, pdu, pdu.hex())
        require_alive(master, fed, SHORT_MS, pdu.hex())
        require_expiry(master, fed, SHORT_MS, pdu.hex())
        owner.hang_up()


@case(881, "5.7", "an owner that hangs up leaves its time as it is, no longer and no shorter", motion=True)
def hanging_up_changes_no_time(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    owner = master.second()
    fed = timed(owner, word_request(spare, 1), "the owner's write")
    wait(0.6 * SHORT_MS)
    owner.hang_up()
    require_expiry(master.second(), fed, SHORT_MS, "the owner hung up")


@case(882, "5.7", "after the owner has hung up, another master's write begins its time anew", motion=True)
def another_writes_first(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=SHORT_MS)
    first, then = master.second(), master.second()
    first.done(word_request(spare, 1), "the first owner's write")
    first.hang_up()
    wait(0.6 * SHORT_MS)
    fed = Moment(0.0, 0.0)
    for _ in range(2):
        fed = timed(then, word_request(spare, 2), "the other master's write")
        wait(0.7 * SHORT_MS)
        require_alive(master, fed, SHORT_MS, "another master had written")
    require_expiry(master, fed, SHORT_MS, "another master had written")


@case(883, "5.1", "with a time of 0 nothing runs: no time is left, and it can be set", motion=True)
def off(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=0)
    master.done(word_request(spare, 1), "a write")
    require_unarmed(master, "a write with a time of 0")
    wait(3 * SHORT_MS)
    require(not master.expired, "it expired although it is off")
    require(master.word(spare) == 1, "the output has changed")
