"""Cases 601…: frames on the stream, and what every request is checked for (clauses 1 and 2)."""

import struct
import time
from collections.abc import Iterable
from typing import NamedTuple

from conformance.case import coupler
from conformance.master import (
    INPUTS,
    OUTPUTS,
    READ_COILS,
    READ_DISCRETE,
    READ_HOLDING,
    READ_INPUT,
    Master,
    read_request,
)
from conformance.wire import Failed, require

# Slack of the cases that time the coupler: how late it may be, and how much its clock's steps may be.
LATE_MS = 50.0
STEP_MS = 5.0
LOOK_EACH_MS = 5.0
_LOOK_BEFORE_MS = 30.0


class Moment(NamedTuple):
    """When the coupler did something: between these two times of the tester, ms."""

    earliest_ms: float
    latest_ms: float


def now_ms() -> float:
    """The tester's time, ms."""
    return time.monotonic() * 1e3


def wait(ms: float) -> None:
    """Lets time pass."""
    time.sleep(max(ms, 0.0) / 1e3)


def timed(master: Master, pdu: bytes, what: str) -> Moment:
    """When the coupler carried out ``pdu``; raises Failed when it refused."""
    before = now_ms()
    master.done(pdu, what)
    return Moment(before, now_ms())


def wait_until(ms: float) -> None:
    """Lets time pass until the tester's clock shows ``ms``."""
    wait(ms - now_ms())


def require_expiry(observer: Master, fed: Moment, time_ms: float, why: str) -> None:
    """Raises Failed unless the watchdog expires ``time_ms`` after it was fed.

    Slack: not more than STEP_MS early, not more than LATE_MS late.
    """
    wait_until(fed.latest_ms + time_ms - _LOOK_BEFORE_MS)
    while True:
        asked_ms = now_ms()
        expired = observer.expired
        if expired:
            early_ms = fed.earliest_ms + time_ms - now_ms()
            require(
                early_ms <= STEP_MS, f"{why}: expired at least {early_ms:.0f} ms before its {time_ms:g} ms"
            )
            return
        late_ms = asked_ms - fed.latest_ms - time_ms
        require(late_ms <= LATE_MS, f"{why}: not expired {late_ms:.0f} ms after its {time_ms:g} ms")
        wait(LOOK_EACH_MS)


def require_alive(observer: Master, fed: Moment, time_ms: float, why: str) -> None:
    """Raises Failed when the watchdog has expired although ``time_ms`` since ``fed`` have not passed."""
    expired = observer.expired
    early_ms = fed.earliest_ms + time_ms - now_ms()
    require(not expired or early_ms <= STEP_MS, f"{why}: expired at least {early_ms:.0f} ms too soon")


case = coupler.case
READ_ONE = read_request(READ_HOLDING, INPUTS, 1)
LISTED = (1, 2, 3, 4, 5, 6, 8, 15, 16, 23)
FUNCTION, ADDRESS, VALUE = 1, 2, 3


def all_refused(master: Master, requests: Iterable[str], code: int, what: str) -> None:
    """Every request, in hexadecimal, is refused with ``code``."""
    for text in requests:
        master.refused(bytes.fromhex(text), code, f"{what} ({text})")


@case(601, "1.1", "a sound read is answered (the control of the cases below)")
def sound(master: Master) -> None:
    master.words(INPUTS, 1)


@case(602, "1.2", "transaction numbers are repeated, 0 and 65535 among them")
def transactions(master: Master) -> None:
    for number in (0, 1, 0x00FF, 0x1234, 0xFFFF):
        master.ask(READ_ONE, transaction=number)


@case(603, "1.2", "the unit id is repeated, whatever it is")
def units(master: Master) -> None:
    for unit in (0, 1, 17, 247, 255):
        master.ask(READ_ONE, unit=unit)


@case(604, "1.3", "a request that comes byte by byte is put together")
def byte_by_byte(master: Master) -> None:
    for byte in master.frame(READ_ONE):
        master.send_raw(bytes([byte]))
        time.sleep(0.002)
    require(master.receive() is not None, "no answer")


@case(605, "1.3", "several requests in one segment are answered each, in their order")
def merged(master: Master) -> None:
    numbers = list(range(500, 520))
    master.send_raw(b"".join(master.frame(READ_ONE, transaction=number) for number in numbers))
    answers = [master.receive() for _ in numbers]
    require([answer[0] if answer else None for answer in answers] == numbers, "not all, or not in order")


@case(606, "1.3", "one request and a half, then the other half")
def one_and_a_half(master: Master) -> None:
    first, second = master.frame(READ_ONE, transaction=7), master.frame(READ_ONE, transaction=8)
    master.send_raw(first + second[:5])
    answer = master.receive()
    require(answer is not None and answer[0] == 7, "the whole request was not answered")
    require(master.receive(60) is None, "half a request was answered")
    master.send_raw(second[5:])
    answer = master.receive()
    require(answer is not None and answer[0] == 8, "the completed request was not answered")


@case(607, "1.4", "a frame of another protocol ends the connection unanswered")
def other_protocol(master: Master) -> None:
    master.send_raw(struct.pack(">HHHB", 1, 1, len(READ_ONE) + 1, 1) + READ_ONE)
    require(master.is_closed(), "the connection lives on, or was answered on")


@case(608, "1.4", "a frame of an impossible length ends the connection unanswered")
def other_lengths(master: Master) -> None:
    for length in (0, 1, 255, 0xFFFF):
        other = master.second()
        other.send_raw(struct.pack(">HHHB", 1, 0, length, 1) + READ_ONE)
        require(other.is_closed(), f"length {length}: the connection lives on, or was answered on")
    master.words(INPUTS, 1)


@case(609, "1.4", "a master that hangs up within a request disturbs no other")
def half_and_gone(master: Master) -> None:
    other = master.second()
    other.send_raw(other.frame(READ_ONE)[:9])
    other.hang_up()
    master.words(INPUTS, 1)


@case(610, "2.1", "function codes that are not listed are refused with 1 under their own number")
def functions(master: Master) -> None:
    for function in (*range(1, 0x80),):
        if function not in LISTED:
            master.refused(bytes([function, 0, 0, 0, 1]), FUNCTION, f"function code {function}")


@case(611, "2.1", "every listed reading function code is answered")
def reading_functions(master: Master) -> None:
    lengths = master.lengths()
    require(lengths.analog_inputs > 0, "the coupler has no analog inputs")
    master.words(INPUTS, 1, READ_HOLDING)
    master.words(INPUTS, 1, READ_INPUT)
    for function, count in ((READ_COILS, lengths.digital_outputs), (READ_DISCRETE, lengths.digital_inputs)):
        if count:
            master.bits(function, 0, count)
        else:
            master.refused(read_request(function, 0, 1), ADDRESS, "a bit of no terminal")


@case(612, "2.3", "reading 0 or more than 125 registers is refused with 3")
def register_quantities(master: Master) -> None:
    for function in (READ_HOLDING, READ_INPUT):
        for count in (0, 126, 127, 0x100, 0xFFFF):
            master.refused(read_request(function, INPUTS, count), VALUE, f"{function} of {count} registers")


@case(613, "2.3", "reading 0 or more than 2000 bits is refused with 3")
def bit_quantities(master: Master) -> None:
    for function in (READ_COILS, READ_DISCRETE):
        for count in (0, 2001, 0xFFFF):
            master.refused(read_request(function, 0, count), VALUE, f"{function} of {count} bits")


@case(614, "2.3", "writing 0 or more than 123 registers is refused with 3")
def write_quantities(master: Master) -> None:
    master.refused(bytes.fromhex("10 0800 0000 00"), VALUE, "writing nothing")
    too_many = struct.pack(">BHHB", 16, OUTPUTS, 124, 248) + bytes(246)
    master.refused(too_many, VALUE, "writing 124 registers")


@case(615, "2.3", "writing 0 or more than 1968 bits is refused with 3")
def write_bit_quantities(master: Master) -> None:
    master.refused(bytes.fromhex("0F 0000 0000 00"), VALUE, "writing no bit")
    master.refused(struct.pack(">BHHB", 15, 0, 1969, 247) + bytes(247), VALUE, "writing 1969 bits")


@case(616, "2.3", "function code 23 reads 1…125 and writes 1…121 registers, else 3")
def exchange_quantities(master: Master) -> None:
    all_refused(
        master,
        ("17 0000 0000 0800 0001 02 0000", "17 0000 007E 0800 0001 02 0000", "17 0000 0001 0800 0000 00"),
        VALUE,
        "an exchange",
    )
    too_many = struct.pack(">BHHHHB", 23, INPUTS, 1, OUTPUTS, 122, 244) + bytes(242)
    master.refused(too_many, VALUE, "an exchange that writes 122")


@case(617, "2.4", "requests that are too short or too long are refused with 3")
def bodies(master: Master) -> None:
    short = (
        "01",
        "02 00",
        "03 0000",
        "04 0000 00",
        "05 0000",
        "06 0800 00",
        "0F 0000",
        "10 0800 00",
        "17 00",
    )
    long = ("01 0000 0001 00", "03 0000 0001 00", "04 0000 0001 0000", "05 0000 0000 00", "06 0800 0000 00")
    all_refused(master, short + long, VALUE, "a request of a wrong length")


@case(618, "2.4", "a byte count that does not fit the quantity is refused with 3")
def byte_counts(master: Master) -> None:
    all_refused(
        master,
        (
            "10 0800 0002 02 0000",
            "10 0800 0001 04 0000 0000",
            "10 0800 0001 03 0000 00",
            "10 0800 0001 02 00",
            "10 0800 0001 02 0000 00",
            "0F 0000 0008 02 00 00",
            "0F 0000 0009 01 00",
            "0F 0000 0001 01",
            "17 0000 0001 0800 0002 02 0000",
            "17 0000 0001 0800 0001 04 0000 0000",
            "17 0000 0001 0800 0001 02 00",
        ),
        VALUE,
        "a false byte count",
    )


@case(619, "2.5", "a coil is written with FF00 or 0000, any other word is refused with 3")
def coil_words(master: Master) -> None:
    all_refused(master, ("05 0000 0001", "05 0000 00FF", "05 0000 1234", "05 0000 FFFF"), VALUE, "a coil")


@case(620, "2.2", "the quantity is checked before the address")
def order_of_checks(master: Master) -> None:
    all_refused(
        master,
        ("03 7000 0000", "04 7000 007E", "10 7000 0001 03 0000 00", "05 7000 1234"),
        VALUE,
        "both wrong",
    )


@case(621, "2.6", "diagnostics 0 gives the same data back")
def echo(master: Master) -> None:
    for data in ("A537", "0000", "FFFF 1234 5678"):
        request = bytes.fromhex("08 0000" + data)
        require(master.ask(request) == request, f"{data} did not come back")


@case(622, "2.6", "an unknown sub-function of diagnostics is refused with 1, wrong data with 3")
def sub_functions(master: Master) -> None:
    all_refused(master, ("08 0063 0000", "08 FFFF 0000"), FUNCTION, "a sub-function")
    all_refused(master, ("08", "08 0000", "08 0000 12", "08 000B 0001"), VALUE, "diagnostics")


@case(623, "2.6", "diagnostics count exceptions and messages, and are cleared")
def counters(master: Master) -> None:
    master.done(bytes.fromhex("08 000A 0000"), "clearing the counters")
    messages, exceptions = count(master, 11), count(master, 13)
    master.refused(read_request(READ_HOLDING, INPUTS, 0), VALUE, "nothing to read")
    require(count(master, 13) - exceptions == 1, "one exception was not counted once")
    require(count(master, 11) - messages >= 3, "messages are not counted")


def count(master: Master, sub_function: int) -> int:
    """A counter of the diagnostics."""
    answer = master.done(bytes([8, 0, sub_function, 0, 0]), f"diagnostics {sub_function}")
    if len(answer) != 5:
        raise Failed(f"diagnostics {sub_function} answered {answer.hex()}")
    return int.from_bytes(answer[3:], "big")
