"""Cases 671…: the coupler's watchdog (clause 5)."""

from collections.abc import Callable

from conformance.case import coupler
from conformance.coupler.frames import LATE_MS, now_ms, wait
from conformance.coupler.outputs import every_write, spare_word
from conformance.master import (
    INPUTS,
    READ_COILS,
    READ_DISCRETE,
    READ_HOLDING,
    READ_INPUT,
    Master,
    read_request,
    word_request,
)
from conformance.wire import require
from protocol.coupler_registers import (
    ANALOG_OUTPUT_BITS,
    IDENTIFICATION,
    RESET_WORDS,
    WATCHDOG_DEFAULT_MS,
    WATCHDOG_LEFT_MS,
    WATCHDOG_RESET,
    WATCHDOG_TIME_MS,
    WATCHDOG_TRIGGER,
)

case = coupler.case
TIME_MS = 300
SLACK_MS = LATE_MS
EXPIRED = 4


def write(master: Master, spare: int, word: int = 1) -> None:
    """A telegram that owns the outputs, arms and retriggers."""
    master.done(word_request(spare, word), "writing an output")


def let_expire(master: Master) -> int:
    """The spare word's address, after a write and silence; raises Failed when the watchdog did not expire."""
    spare = spare_word(master, watchdog_ms=TIME_MS)
    write(master, spare, 0xFFFF)
    wait(TIME_MS + SLACK_MS)
    require(master.expired, f"no expiry {TIME_MS + SLACK_MS} ms after the only write")
    return spare


@case(671, "5.1", "the watchdog's time is set and read back while it is inactive", motion=True)
def set_time(master: Master) -> None:
    master.take_outputs()
    require(master.word(WATCHDOG_TIME_MS) == WATCHDOG_DEFAULT_MS, "not 1000 ms after it was set so")
    for value in (100, 1234, 0, 0xFFFF, 500):
        master.done(word_request(WATCHDOG_TIME_MS, value), f"setting {value} ms")
        require(master.word(WATCHDOG_TIME_MS) == value, f"{value} ms was read back as another time")


@case(672, "5.2", "reading does not arm the watchdog", motion=True)
def reading_arms_nothing(master: Master) -> None:
    master.take_outputs(watchdog_ms=100)
    master.words(INPUTS, 1)
    wait(100 + SLACK_MS)
    require(not master.expired, "it expired without a write")


@case(673, "5.2", "a refused write does not arm the watchdog", motion=True)
def refusal_arms_nothing(master: Master) -> None:
    master.take_outputs(watchdog_ms=100)
    master.refused(word_request(0x0900, 0), 2, "writing where nothing is")
    wait(100 + SLACK_MS)
    require(not master.expired, "it expired without a write")


@case(674, "5.2", "the first write arms it: silence sets status bit 15", motion=True)
def first_write_arms(master: Master) -> None:
    let_expire(master)


@case(675, "5.2", "each writing function code arms it", motion=True)
def every_write_arms(master: Master) -> None:
    for index in range(5):
        spare = spare_word(master, watchdog_ms=100)
        request = every_write(spare)[index]
        master.done(request, f"function code {request[0]}")
        wait(100 + SLACK_MS)
        require(master.expired, f"function code {request[0]} did not arm it")


@case(676, "5.3", "it does not expire before its time", motion=True)
def not_too_soon(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=1000, trigger=0)
    begin_ms = now_ms()
    write(master, spare)
    other = master.second()
    while now_ms() - begin_ms < 900:
        expired = other.expired
        require(not expired or now_ms() - begin_ms > 1000, "it expired before its time")
        wait(40)


@case(677, "5.3", "any telegram of the owner retriggers it when the trigger is 1", motion=True)
def any_telegram(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=TIME_MS, trigger=1)
    write(master, spare)
    for _ in range(6):
        wait(TIME_MS / 3)
        master.words(INPUTS, 1)
    require(not master.expired, "it expired between telegrams")


@case(678, "5.3", "only writes retrigger it when the trigger is 0", motion=True)
def writes_only(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=TIME_MS, trigger=0)
    for _ in range(6):
        write(master, spare)
        wait(TIME_MS / 3)
    require(not master.expired, "it expired between writes")
    for _ in range(6):
        master.ask(read_request(READ_HOLDING, INPUTS, 1))
        wait(TIME_MS / 3)
    require(master.expired, "reading retriggered it")


@case(679, "5.3", "another master's telegrams do not retrigger it", motion=True)
def owner_only(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=TIME_MS)
    write(master, spare)
    other = master.second()
    for _ in range(6):
        wait(TIME_MS / 3)
        if other.expired:
            return
    require(False, "another master's reading kept it alive")


@case(680, "5.3", "the trigger takes 0 and 1 alone: else 3", motion=True)
def trigger_values(master: Master) -> None:
    master.take_outputs()
    for value in (2, 3, 0x0100, 0x0101, 0x8000, 0xFFFF):
        master.refused(word_request(WATCHDOG_TRIGGER, value), 3, f"trigger {value}")
    for value in (0, 1):
        master.done(word_request(WATCHDOG_TRIGGER, value), f"trigger {value}")
        require(master.word(WATCHDOG_TRIGGER) == value, "read back as another value")


@case(681, "5.1", "while it is active its time cannot be set: 4", motion=True)
def time_while_active(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=1000)
    write(master, spare)
    master.refused(word_request(WATCHDOG_TIME_MS, 0), EXPIRED, "setting the time of an active watchdog")
    require(master.word(WATCHDOG_TIME_MS) == 1000, "the time changed")


@case(682, "5.1", "a time of 0 switches it off", motion=True)
def off(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=0)
    write(master, spare)
    wait(WATCHDOG_DEFAULT_MS + SLACK_MS)
    require(not master.expired, "it expired although it is off")


@case(683, "5.4", "after expiry every access to the process image is refused with 4", motion=True)
def refuses_all(master: Master) -> None:
    spare = let_expire(master)
    reads = (READ_COILS, READ_DISCRETE, READ_HOLDING, READ_INPUT)
    for request in [*(read_request(function, 0, 1) for function in reads), *every_write(spare)]:
        master.refused(request, EXPIRED, f"function code {request[0]} after expiry")


@case(684, "5.4", "after expiry the coupler's own registers are still read", motion=True)
def own_registers(master: Master) -> None:
    let_expire(master)
    master.words(IDENTIFICATION, 7)
    master.words(ANALOG_OUTPUT_BITS, 4)
    require(master.word(WATCHDOG_LEFT_MS) == 0, "time is left after expiry")
    echo = bytes.fromhex("08 0000 1234")
    require(master.ask(echo) == echo, "diagnostics are not answered")


@case(685, "5.4", "expiry latches, through telegrams and new connections", motion=True)
def latches(master: Master) -> None:
    spare = let_expire(master)
    for _ in range(5):
        master.refused(word_request(spare, 1), EXPIRED, "a write after expiry")
    other = master.second()
    require(other.expired, "a new connection cleared it")
    other.refused(word_request(spare, 1), EXPIRED, "a new connection's write")


@case(686, "5.4", "at expiry the outputs go to zero", motion=True)
def zeroes(master: Master) -> None:
    spare = let_expire(master)
    master.reset()
    word = master.word(spare)
    require(word == 0, f"the output is {word:#06x}")


@case(687, "5.5", "the two reset words clear it, and the next write arms it again", motion=True)
def resets(master: Master) -> None:
    spare = let_expire(master)
    master.reset()
    require(not master.expired, "status bit 15 is still set")
    wait(TIME_MS + SLACK_MS)
    require(not master.expired, "it was armed without a write")
    write(master, spare)
    wait(TIME_MS + SLACK_MS)
    require(master.expired, "the write after the reset did not arm it")


@case(688, "5.5", "the first reset word alone clears nothing", motion=True)
def first_word(master: Master) -> None:
    stays(master, lambda: _words(master, RESET_WORDS[0]))


@case(689, "5.5", "the second reset word alone clears nothing", motion=True)
def second_word(master: Master) -> None:
    stays(master, lambda: _words(master, RESET_WORDS[1]))


@case(690, "5.5", "the reset words in reverse clear nothing", motion=True)
def reversed_words(master: Master) -> None:
    stays(master, lambda: _words(master, *reversed(RESET_WORDS)))


@case(691, "5.5", "another word between the two spoils the reset", motion=True)
def interrupted_words(master: Master) -> None:
    stays(master, lambda: _words(master, RESET_WORDS[0], 0x0000, RESET_WORDS[1]))


@case(692, "5.5", "two masters cannot each give one of the reset words", motion=True)
def shared_words(master: Master) -> None:
    def each_one() -> None:
        _words(master, RESET_WORDS[0])
        _words(master.second(), RESET_WORDS[1])

    stays(master, each_one)


@case(693, "5.5", "a word that is no reset word is refused with 3", motion=True)
def no_reset_word(master: Master) -> None:
    master.take_outputs()
    for word in (0x0000, 0xAFFE, 0xCFBE, 0xFFFF):
        master.refused(word_request(WATCHDOG_RESET, word), 3, f"reset word {word:#06x}")


@case(694, "5.6", "the time left counts down and starts again with a write", motion=True)
def time_left(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=2000, trigger=0)
    require(master.word(WATCHDOG_LEFT_MS) == 0, "time is left while it is inactive")
    write(master, spare)
    begin_ms = now_ms()
    first = master.word(WATCHDOG_LEFT_MS)
    wait(300)
    passed_ms = now_ms() - begin_ms
    second = master.word(WATCHDOG_LEFT_MS)
    require(1500 <= first <= 2000, f"{first} ms left right after the write")
    require(abs(first - second - passed_ms) < SLACK_MS, f"{first - second} ms less after {passed_ms:.0f} ms")
    write(master, spare)
    require(master.word(WATCHDOG_LEFT_MS) > second, "a write did not start it again")


@case(695, "5.7", "an owner that hangs up leaves it running: it expires", motion=True)
def cut_cable(master: Master) -> None:
    spare = spare_word(master, watchdog_ms=TIME_MS)
    owner = master.second()
    write(owner, spare)
    owner.hang_up()
    wait(TIME_MS + SLACK_MS)
    require(master.expired, "no expiry after the owner had hung up")


@case(696, "5.5", "after expiry and reset another master may own the outputs", motion=True)
def new_owner(master: Master) -> None:
    spare = let_expire(master)
    other = master.second()
    other.reset()
    write(other, spare)
    master.refused(word_request(spare, 0), 6, "the owner of before")


def stays(master: Master, attempt: Callable[[], None]) -> None:
    """An attempt to reset that must not work."""
    let_expire(master)
    attempt()
    require(master.expired, "it was reset")


def _words(master: Master, *words: int) -> None:
    for word in words:
        master.ask(word_request(WATCHDOG_RESET, word))
