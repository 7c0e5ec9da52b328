"""Cases 911…: the images of this plant (clauses 2.9 and 5.8, and protocol.md, clause 10).

What is written here is not enabled and has its valves centred, or is torn: nothing moves.
"""

import struct
from itertools import pairwise

from conformance.case import coupler
from conformance.coupler.frames import LATE_MS, STEP_MS, VALUE, Moment, now_ms, timed, wait
from conformance.coupler.outputs import spare_word
from conformance.coupler.registers import STATUS_WORD, plant_words
from conformance.coupler.watchdog import let_expire
from conformance.master import (
    INPUTS,
    OUTPUTS,
    READ_HOLDING,
    READ_INPUT,
    Master,
    exchange_request,
    read_request,
    word_request,
    write_request,
)
from conformance.wire import Failed, Unsupported, require
from protocol.process_image import (
    CONTROL_RESET_WATCHDOG,
    INPUT_TABLE,
    INPUT_WORDS,
    OUTPUT_TABLE,
    OUTPUT_WORDS,
    STATUS_WATCHDOG_TRIPPED,
)

case = coupler.case
VALVES = next(row for row in OUTPUT_TABLE if row.name == "valves")
SPOOLS = range(VALVES.address, VALVES.address + VALVES.words)
LAST = OUTPUTS + OUTPUT_WORDS - 1
RESERVED = next(row for row in INPUT_TABLE if row.reserved)
ECHO_WORD = next(row.address for row in INPUT_TABLE if row.name == "echo_cycle")
MOTION_WATCHDOG_MS = 100
SAME_CYCLE_TRIES = 100
MOST_APART = 200  # plant cycles between two requests of one piece
# The plant may take as long to show in its inputs what it was told: a few of its cycles.
SHOWN_MS = 50.0
IMPOSSIBLE = 0x8000


def this_plant(master: Master, watchdog_ms: int = 5000) -> None:
    """The outputs taken; raises Unsupported unless both images are those of protocol.md, clause 10."""
    spare = spare_word(master, watchdog_ms=watchdog_ms)
    if spare - OUTPUTS != OUTPUT_WORDS:
        raise Unsupported("outputs of another plant")
    plant_words(master)


def image(cycle: int, control: int = 0, *, again: int | None = None) -> list[int]:
    """The output words: valves centred; torn where ``again`` is another cycle."""
    return [cycle, control, *[0] * (OUTPUT_WORDS - 3), cycle if again is None else again]


def exchange(master: Master, words: list[int]) -> list[int]:
    """The inputs that came with writing ``words``, as a controller does it."""
    answer = master.done(exchange_request(INPUTS, INPUT_WORDS, OUTPUTS, words), "an exchange")
    return list(struct.unpack(f">{INPUT_WORDS}H", answer[2:]))


def echo(master: Master, cycle: int) -> None:
    """Raises Failed unless the plant tells within SHOWN_MS that it took over ``cycle``."""
    until_ms = now_ms() + SHOWN_MS
    while True:
        asked_ms = now_ms()
        got = master.word(INPUTS + ECHO_WORD)
        if got == cycle:
            return
        require(asked_ms < until_ms, f"the echo is {got}, not {cycle}, after {SHOWN_MS:g} ms")
        wait(2)


@case(911, "10.4", "the inputs are of this layout, and their reserved words are zero")
def input_image(master: Master) -> None:
    plant_words(master)
    for function in (READ_HOLDING, READ_INPUT):
        spare = master.words(INPUTS + RESERVED.address, RESERVED.words, function)
        require(not any(spare), f"reserved words {spare}")


@case(922, "10.3", "inputs that are read in one request are whole: the first word is the last")
def whole_inputs(master: Master) -> None:
    plant_words(master)
    for function in (READ_HOLDING, READ_INPUT):
        for _ in range(5):
            words = master.words(INPUTS, INPUT_WORDS, function)
            require(words[0] == words[-1], f"with {function}: cycle {words[0]} first, {words[-1]} last")
            wait(7)


def together(master: Master, requests: list[bytes]) -> list[list[int]]:
    """The whole inputs that each of ``requests`` reads; all are sent in one piece."""
    master.send_raw(b"".join(master.frame(pdu) for pdu in requests))
    read = []
    for pdu in requests:
        answer = master.receive()
        whole = answer is not None and len(answer[2]) == 2 + 2 * INPUT_WORDS and answer[2][0] == pdu[0]
        require(whole, f"function code {pdu[0]} was not answered with {INPUT_WORDS} words")
        assert answer is not None
        read.append(list(struct.unpack(f">{INPUT_WORDS}H", answer[2][2:])))
    return read


@case(924, "3.1", "inputs of one plant cycle are the same words with 3, 4 and 23", motion=True)
def alike_inputs(master: Master) -> None:
    this_plant(master)
    requests = [
        read_request(READ_HOLDING, INPUTS, INPUT_WORDS),
        read_request(READ_INPUT, INPUTS, INPUT_WORDS),
        exchange_request(INPUTS, INPUT_WORDS, OUTPUTS, image(1)),
    ]
    echo_and_status = (ECHO_WORD, STATUS_WORD)  # the exchange's own image may act in between
    for pair in (requests[:2], requests[1:]):
        for _ in range(SAME_CYCLE_TRIES):
            one, other = together(master, pair)
            apart = (other[0] - one[0]) % 0x10000
            require(apart < MOST_APART, f"cycle {one[0]} with {pair[0][0]}, {other[0]} with {pair[1][0]}")
            if one[0] == other[0]:
                differ = [at for at, (a, b) in enumerate(zip(one, other, strict=True)) if a != b]
                differ = [at for at in differ if at not in echo_and_status]
                require(not differ, f"with {pair[0][0]} and {pair[1][0]} the words {differ} differ")
                break
        else:
            raise Unsupported("no two requests in one piece were answered within one plant cycle")


@case(925, "10.6", "inputs are of the moment of the request, not of the one before", motion=True)
def inputs_of_the_moment(master: Master) -> None:
    this_plant(master)
    for pdu in (
        read_request(READ_HOLDING, INPUTS, INPUT_WORDS),
        read_request(READ_INPUT, INPUTS, INPUT_WORDS),
        exchange_request(INPUTS, INPUT_WORDS, OUTPUTS, image(1)),
    ):
        ((earlier, *_),) = together(master, [pdu])
        wait(100)
        (first, *_), (second, *_) = together(master, [pdu, pdu])
        late, passed = (second - first) % 0x10000, (second - earlier) % 0x10000
        require(
            2 * late < passed, f"with {pdu[0]}: {late} of {passed} cycles, 100 ms, behind the next request"
        )


@case(923, "10.5", "all registers zero is a valid image, and acts", motion=True)
def zero_image(master: Master) -> None:
    this_plant(master)
    exchange(master, image(77))
    echo(master, 77)
    exchange(master, image(0))
    echo(master, 0)


@case(912, "10.6", "the plant's cycle advances, also while nobody writes")
def plant_cycle(master: Master) -> None:
    plant_words(master)
    seen = []
    for _ in range(4):
        seen.append(master.word(INPUTS))
        wait(100)
    require(len(set(seen)) == len(seen), f"cycles {seen}, 100 ms apart")
    steps = [(after - before) % 0x10000 for before, after in pairwise(seen)]
    require(max(steps) < 0x8000, f"cycles {seen} run backwards")


@case(913, "10.6", "the echo repeats the cycle of each whole image, over its wrap", motion=True)
def echoes(master: Master) -> None:
    this_plant(master)
    for cycle in (1, 2, 0x7FFF, 0x8000, 0xFFFF, 0, 1):
        exchange(master, image(cycle))
        echo(master, cycle)


@case(914, "2.9", "a torn image is kept and read back, and does not act until it is whole", motion=True)
def torn_image(master: Master) -> None:
    this_plant(master)
    master.done(write_request(OUTPUTS, image(1000)), "a whole image")
    echo(master, 1000)
    for pdu, at, word in (
        (word_request(OUTPUTS, 1001), OUTPUTS, 1001),
        (write_request(OUTPUTS, image(1002, again=1000)), OUTPUTS, 1002),
        (exchange_request(INPUTS, 1, OUTPUTS, image(1003, again=7)), LAST, 7),
    ):
        master.done(pdu, "a torn image")
        require(master.word(at) == word, "the torn image is not read back")
        wait(SHOWN_MS)
        echo(master, 1000)
    master.done(word_request(LAST, 1003), "the word that makes it whole")
    echo(master, 1003)


@case(
    915,
    "2.9",
    "a spool command of -32768 is refused whole with 3, with 6, 16 and 23, and not written",
    motion=True,
)
def impossible_command(master: Master) -> None:
    this_plant(master)
    for cycle, again in ((5, 5), (9999, 5)):  # whole, and torn
        kept = image(cycle, again=again)
        master.done(write_request(OUTPUTS, kept), "an image")
        for spool in SPOOLS:
            words = image(77)
            words[spool - OUTPUTS] = IMPOSSIBLE
            for pdu in (
                word_request(spool, IMPOSSIBLE), write_request(spool - 1, [0, IMPOSSIBLE]),
                write_request(OUTPUTS, words), exchange_request(INPUTS, 1, OUTPUTS, words),
            ):  # fmt: skip
                master.refused(pdu, VALUE, f"-32768 at {spool:#06x} with {pdu[0]}")
            require(
                master.words(OUTPUTS, OUTPUT_WORDS) == kept, f"-32768 at {spool:#06x}: something was written"
            )
    master.done(word_request(LAST, 9999), "the word that makes the image whole")
    echo(master, 9999)


@case(916, "2.9", "-32767 is taken in every spool, and the word 8000 everywhere else", motion=True)
def possible_commands(master: Master) -> None:
    this_plant(master)
    master.done(word_request(OUTPUTS, 4321), "tearing the image")
    for address in range(OUTPUTS, OUTPUTS + OUTPUT_WORDS):
        for word in (
            (0x8001, 0x7FFF) if address in SPOOLS else (IMPOSSIBLE, 4321 if address == OUTPUTS else 0)
        ):
            master.done(word_request(address, word), f"{word:#06x} at {address:#06x}")
            require(master.word(address) == word, f"{word:#06x} at {address:#06x} is not read back")
    words = image(8, again=9)
    words[SPOOLS[0] - OUTPUTS] = 0x8001
    master.done(exchange_request(INPUTS, 1, OUTPUTS, words), "-32767 with 23")


@case(917, "5.4", "the zeros of an expiry act: the plant takes their cycle over", motion=True)
def zeros_act(master: Master) -> None:
    this_plant(master, watchdog_ms=300)
    exchange(master, image(4242))
    echo(master, 4242)
    wait(300 + LATE_MS)
    require(master.expired, f"no expiry {LATE_MS:g} ms after its time")
    master.reset()
    echo(master, 0)


def status(master: Master) -> int:
    """The register ``status`` of the inputs."""
    return master.word(INPUTS + STATUS_WORD)


def running(master: Master) -> Moment:
    """The motion watchdog cleared by an edge; when the newest cycle was written."""
    for cycle, control in ((1, 0), (2, CONTROL_RESET_WATCHDOG), (3, 0)):
        written = timed(master, write_request(OUTPUTS, image(cycle, control)), "an image")
        wait(2)
    until_ms = now_ms() + SHOWN_MS
    while status(master) & STATUS_WATCHDOG_TRIPPED:
        require(now_ms() < until_ms, "a rising edge of RESET_WATCHDOG does not clear WATCHDOG_TRIPPED")
        written = timed(master, write_request(OUTPUTS, image(int(now_ms()) & 0xFFFF)), "an image")
    return written


def require_trip(master: Master, written: Moment) -> None:
    """Raises Failed unless the motion watchdog trips in its time; slack 5 ms early, 50 ms late."""
    while True:
        asked_ms = now_ms()
        if status(master) & STATUS_WATCHDOG_TRIPPED:
            early_ms = written.earliest_ms + MOTION_WATCHDOG_MS - now_ms()
            require(early_ms <= STEP_MS, f"tripped {early_ms:.0f} ms before {MOTION_WATCHDOG_MS} ms")
            return
        late_ms = asked_ms - written.latest_ms - MOTION_WATCHDOG_MS
        require(late_ms <= LATE_MS, f"not tripped {late_ms:.0f} ms after {MOTION_WATCHDOG_MS} ms")
        wait(5)


@case(
    918, "10.7", "the motion watchdog trips when the cycle stands still, also while images come", motion=True
)
def motion_watchdog(master: Master) -> None:
    this_plant(master)
    require_trip(master, running(master))
    running(master)
    written = timed(master, write_request(OUTPUTS, image(50)), "an image")
    for _ in range(6):
        wait(25)
        master.done(write_request(OUTPUTS, image(50)), "the same image again")
    require_trip(master, written)


@case(919, "10.7", "the motion watchdog does not trip while the cycle advances, over its wrap", motion=True)
def advancing_cycle(master: Master) -> None:
    this_plant(master)
    running(master)
    for step in range(12):
        before_ms = now_ms()
        master.done(write_request(OUTPUTS, image((0xFFFA + step) & 0xFFFF)), "an image")
        wait(40)
        tripped = status(master) & STATUS_WATCHDOG_TRIPPED
        if tripped and now_ms() - before_ms < MOTION_WATCHDOG_MS - STEP_MS:
            raise Failed("it tripped between images 40 ms apart")


@case(920, "10.7", "a tripped motion watchdog stays so until a rising edge of RESET_WATCHDOG", motion=True)
def latched_trip(master: Master) -> None:
    this_plant(master)
    running(master)
    master.done(write_request(OUTPUTS, image(20, CONTROL_RESET_WATCHDOG)), "the bit, and nothing more")
    wait(MOTION_WATCHDOG_MS + SHOWN_MS + LATE_MS)
    require(bool(status(master) & STATUS_WATCHDOG_TRIPPED), "it did not trip")
    for cycle in range(21, 27):
        master.done(write_request(OUTPUTS, image(cycle, CONTROL_RESET_WATCHDOG)), "the bit held")
        wait(20)
        require(
            bool(status(master) & STATUS_WATCHDOG_TRIPPED), "an advancing cycle or the held bit cleared it"
        )
    running(master)


@case(921, "5.8", "a reset of the coupler's watchdog leaves the motion watchdog tripped", motion=True)
def coupler_reset_is_none(master: Master) -> None:
    this_plant(master)
    running(master)
    wait(MOTION_WATCHDOG_MS + SHOWN_MS + LATE_MS)
    let_expire(master)
    master.reset()
    wait(SHOWN_MS)
    require(bool(status(master) & STATUS_WATCHDOG_TRIPPED), "it was cleared with the coupler's watchdog")
