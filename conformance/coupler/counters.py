"""Cases 821…: what the diagnostics count (clause 2.6).

Other masters may be talking meanwhile, so what counts requests may count more than the tester's: the least
of several tries is judged.
"""

from collections.abc import Callable

from conformance.case import coupler
from conformance.coupler.frames import ADDRESS, FUNCTION, READ_ONE, VALUE, count
from conformance.coupler.limits import FRAMING_HEAD
from conformance.master import DIAGNOSTICS, INPUTS, READ_HOLDING, Master, read_request
from conformance.wire import require
from protocol.coupler_registers import STATUS

case = coupler.case
REQUESTS, FRAMES, EXCEPTIONS, ADDRESSED = 11, 12, 13, 14
TRIES = 10
CLEAR = bytes([DIAGNOSTICS, 0, 10, 0, 0])


def least_growth(master: Master, sub_function: int, meanwhile: Callable[[], None]) -> int:
    """By how much a counter grows, at least, from one question to the next."""
    found = []
    for _ in range(TRIES):
        before = count(master, sub_function)
        meanwhile()
        found.append((count(master, sub_function) - before) % 0x10000)
    return min(found)


def _sound(master: Master) -> None:
    master.words(INPUTS, 1)
    master.ask(bytes.fromhex("08 0000 1234"))


def _refused(master: Master) -> None:
    master.refused(b"\x07", FUNCTION, "function code 7")
    master.refused(read_request(READ_HOLDING, 0x7000, 1), ADDRESS, "an address")
    master.refused(read_request(READ_HOLDING, INPUTS, 0), VALUE, "a quantity")
    master.refused(bytes.fromhex("08 0063 0000"), FUNCTION, "a sub-function")


@case(821, "2.6", "sub-functions 11 and 14 count every request once, sound or refused")
def requests_counted(master: Master) -> None:
    for sub in (REQUESTS, ADDRESSED):
        for each, wanted in ((_sound, 3), (_refused, 5)):
            got = least_growth(master, sub, lambda each=each: each(master))  # type: ignore[misc]
            require(got == wanted, f"sub-function {sub} grew by {got} with {wanted} requests")


@case(822, "2.6", "sub-function 13 counts every exception once and nothing else")
def exceptions_counted(master: Master) -> None:
    for each, wanted in ((_sound, 0), (_refused, 4)):
        got = least_growth(master, EXCEPTIONS, lambda each=each: each(master))  # type: ignore[misc]
        require(got == wanted, f"it grew by {got} with {wanted} exceptions")


@case(823, "2.6", "sub-function 12 counts every frame that ends a connection and nothing else")
def frames_counted(master: Master) -> None:
    def lose(protocol: int, length: int) -> None:
        lost = master.second()
        lost.send_raw(FRAMING_HEAD.pack(1, protocol, length, 1) + READ_ONE)
        require(lost.is_closed(), "the connection lives on, or was answered on")

    before = count(master, FRAMES)
    for protocol, length in ((1, 6), (0, 1), (0, 255)):
        lose(protocol, length)
    got = (count(master, FRAMES) - before) % 0x10000
    require(got == 3, f"it grew by {got} with 3 such frames")
    _sound(master)
    _refused(master)
    require((count(master, FRAMES) - before) % 0x10000 == 3, "it counts other requests too")


@case(824, "2.6", "sub-function 10 clears every counter and gives its data back")
def counters_cleared(master: Master) -> None:
    lost = master.second()
    lost.send_raw(FRAMING_HEAD.pack(1, 1, 6, 1) + READ_ONE)
    require(lost.is_closed(), "the connection lives on, or was answered on")
    for sub, most in ((EXCEPTIONS, 0), (FRAMES, 0), (REQUESTS, 1), (ADDRESSED, 1)):
        found = []
        for _ in range(TRIES):
            _refused(master)
            require(master.ask(CLEAR) == CLEAR, "the data did not come back")
            found.append(count(master, sub))
        require(min(found) <= most, f"sub-function {sub} stands at {min(found)} right after clearing")


@case(825, "2.6", "sub-function 2 is the status word of the register")
def status_word(master: Master) -> None:
    for _ in range(TRIES):
        before, told, after = master.word(STATUS), count(master, 2), master.word(STATUS)
        if before == after:
            require(told == before, f"sub-function 2 tells {told:#06x}, the register {before:#06x}")
            return
