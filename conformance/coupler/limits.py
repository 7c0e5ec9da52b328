"""Cases 801…: both sides of every limit of clauses 1 and 2; nothing here reaches an output."""

import struct
from collections.abc import Callable

from conformance.case import coupler
from conformance.coupler.frames import ADDRESS, FUNCTION, LISTED, READ_ONE, VALUE
from conformance.coupler.frames import count as counter
from conformance.master import (
    DIAGNOSTICS,
    EXCHANGE,
    INPUTS,
    ON,
    READ_COILS,
    READ_DISCRETE,
    READ_HOLDING,
    READ_INPUT,
    WRITE_COIL,
    WRITE_COILS,
    WRITE_REGISTER,
    WRITE_REGISTERS,
    Master,
    exchange_request,
    read_request,
    word_request,
    write_request,
)
from conformance.wire import require
from protocol.coupler_registers import IDENTIFICATION, STATUS

case = coupler.case
NOWHERE, BETWEEN = 0x7000, 0x0900  # no register; the second lies within the process image
UNITS = (0, 17, 255)
FRAMING_HEAD = struct.Struct(">HHHB")


def coils_request(address: int, count: int, data: bytes) -> bytes:
    """A request of function code 15."""
    return struct.pack(">BHHB", WRITE_COILS, address, count, len(data)) + data


def nowhere_requests(address: int = NOWHERE) -> dict[int, bytes]:
    """A request of every function code with addresses that is sound but for its ``address``."""
    return {
        **{function: read_request(function, address, 1) for function in (1, 2, 3, 4)},
        WRITE_COIL: struct.pack(">BHH", WRITE_COIL, address, ON),
        WRITE_REGISTER: word_request(address, 0),
        WRITE_COILS: coils_request(address, 9, bytes(2)),
        WRITE_REGISTERS: write_request(address, [0, 0]),
        EXCHANGE: exchange_request(address, 1, address, [0, 0]),
    }


@case(801, "1.1", "four masters at once are each answered, whoever asks first")
def several_masters(master: Master) -> None:
    masters = [master, *(master.second() for _ in range(3))]
    for number, each in enumerate(masters):
        each.send_raw(each.frame(READ_ONE, transaction=700 + number))
    for number, each in reversed(list(enumerate(masters))):
        answer = each.receive()
        require(answer is not None and answer[0] == 700 + number, f"master {number + 1} was not answered")


@case(802, "1.2", "refusals, and the answers to every reading function code, repeat transaction and unit")
def units_of_refusals(master: Master) -> None:
    for transaction, unit in zip((0, 0x1234, 0xFFFF), UNITS, strict=True):
        for pdu in (*nowhere_requests().values(), b"\x07", bytes.fromhex("08 0063 0000")):
            answer = master.ask(pdu, transaction=transaction, unit=unit)
            require(answer[0] == pdu[0] | 0x80, f"{pdu.hex()} was answered {answer.hex()}")
        for pdu in reading_requests(master):
            answer = master.ask(pdu, transaction=transaction, unit=unit)
            require(answer[0] == pdu[0], f"{pdu.hex()} was answered {answer.hex()}")


def reading_requests(master: Master) -> list[bytes]:
    """A request of every function code that only reads and of diagnostics, for what the coupler has."""
    lengths = master.lengths()
    coils = [read_request(READ_COILS, 0, 1)] if lengths.digital_outputs else []
    discrete = [read_request(READ_DISCRETE, 0, 1)] if lengths.digital_inputs else []
    words = [read_request(function, IDENTIFICATION, 1) for function in (READ_HOLDING, READ_INPUT)]
    return [*coils, *discrete, *words, bytes.fromhex("08 0000 1234")]


@case(803, "1.3", "requests of every kind in one segment are answered in their order")
def mixed_segment(master: Master) -> None:
    requests = [READ_ONE, *nowhere_requests().values(), bytes.fromhex("08 0000 1234"), b"\x07", READ_ONE]
    frames = [master.frame(pdu, transaction=900 + at) for at, pdu in enumerate(requests)]
    master.send_raw(b"".join(frames))
    for at, pdu in enumerate(requests):
        answer = master.receive()
        require(answer is not None, f"request {at + 1} of {len(requests)} was not answered")
        assert answer is not None
        require(answer[0] == 900 + at and answer[2][0] & 0x7F == pdu[0], f"request {at + 1}: {answer[0]}")


@case(816, "1.3", "wherever a request is cut, it is answered once and when it is whole")
def cut_anywhere(master: Master) -> None:
    whole = master.frame(read_request(READ_HOLDING, IDENTIFICATION, 1), transaction=4660)
    for size in range(1, len(whole)):
        master.send_raw(whole[:size])
        require(master.receive(20) is None, f"answered after {size} of {len(whole)} bytes")
        master.send_raw(whole[size:])
        answer = master.receive()
        require(answer is not None and answer[0] == 4660, f"cut after {size} bytes: not answered")
        assert answer is not None
        require(len(answer[2]) == 4 and answer[2][:2] == b"\x03\x02", f"answered {answer[2].hex()}")


@case(804, "1.4", "every bit of the protocol number ends the connection, and no other connection")
def protocol_bits(master: Master) -> None:
    for protocol in (1 << bit for bit in range(16)):
        lost = master.second()
        lost.send_raw(FRAMING_HEAD.pack(1, protocol, len(READ_ONE) + 1, 1) + READ_ONE)
        require(lost.is_closed(), f"protocol {protocol:#06x}: the connection lives on, or was answered on")
        master.words(INPUTS, 1)


@case(805, "1.4", "the shortest and the longest frame are answered")
def extreme_frames(master: Master) -> None:
    master.refused(b"\x07", FUNCTION, "a frame of length 2")
    longest = bytes.fromhex("08 0000") + bytes(range(250))
    require(master.ask(longest) == longest, "a frame of length 254 was not given back")


@case(806, "1.4", "what came before the lost place is answered, what follows it is not")
def before_the_lost_place(master: Master) -> None:
    for bad in (
        FRAMING_HEAD.pack(8, 1, 6, 1),
        FRAMING_HEAD.pack(8, 0, 255, 1),
        FRAMING_HEAD.pack(8, 0, 1, 1),
    ):
        other = master.second()
        sound = other.frame(READ_ONE, transaction=7)
        other.send_raw(sound + bad + READ_ONE + other.frame(READ_ONE, transaction=9))
        answer = other.receive()
        require(answer is not None and answer[0] == 7, "the sound request before it was not answered")
        require(other.is_closed(), "the connection lives on, or was answered on")


@case(807, "1.4", "a master that hangs up anywhere within a request disturbs no other")
def hang_ups(master: Master) -> None:
    whole = master.frame(READ_ONE)
    for size in (1, 6, 7, 8, len(whole) - 1):
        other = master.second()
        other.send_raw(whole[:size])
        other.hang_up()
        master.words(INPUTS, 1)


@case(808, "2.1", "function codes 0 and 128 to 255 are refused with 1")
def functions_beyond(master: Master) -> None:
    for function in (0, *range(0x80, 0x100)):
        master.refused(bytes([function, 0, 0, 0, 1]), FUNCTION, f"function code {function}")


@case(809, "2.2", "of two faults the first in the order is told, with every function code")
def order_of_two(master: Master) -> None:
    for function, pdu in nowhere_requests().items():
        master.refused(pdu, ADDRESS, f"function code {function}, address wrong")
        master.refused(pdu + b"\0", VALUE, f"function code {function}, length and address wrong")
    for function in (READ_COILS, READ_DISCRETE, READ_HOLDING, READ_INPUT):
        master.refused(read_request(function, NOWHERE, 0), VALUE, f"{function}, quantity and address wrong")
    for function in set(range(1, 128)) - set(LISTED):
        master.refused(bytes([function]), FUNCTION, f"{function} alone, which is not listed")
    for data in ("", "00", "0001", "0000 00"):
        master.refused(bytes.fromhex("08 0063" + data), FUNCTION, f"a sub-function, data {data or 'none'}")


@case(810, "2.3", "the smallest and largest quantities are not refused for their size")
def sound_quantities(master: Master) -> None:
    for function, most in ((1, 2000), (2, 2000), (3, 125), (4, 125)):
        for count in (1, most):
            master.refused(read_request(function, NOWHERE, count), ADDRESS, f"{function} of {count}")
    for count in (1, 8, 9, 1968):
        master.refused(coils_request(NOWHERE, count, bytes((count + 7) // 8)), ADDRESS, f"15 of {count}")
    for count in (1, 123):
        master.refused(write_request(NOWHERE, [0] * count), ADDRESS, f"16 of {count}")
    for reads, writes in ((1, 1), (125, 1), (1, 121), (125, 121)):
        pdu = exchange_request(NOWHERE, reads, NOWHERE, [0] * writes)
        master.refused(pdu, ADDRESS, f"23 that reads {reads}, writes {writes}")


@case(811, "2.4", "a request cut short anywhere, or longer than it says, is refused with 3")
def every_length(master: Master) -> None:
    for function, pdu in nowhere_requests().items():
        wrong = [pdu[:size] for size in range(1, len(pdu))] + [pdu + bytes(more) for more in (1, 2)]
        if function in (READ_COILS, READ_DISCRETE):  # cut, its quantity would still be a sound one
            wrong.append(read_request(function, NOWHERE, 0x0101)[:-1])
        for each in wrong:
            master.refused(each, VALUE, f"{function} of {len(each)} bytes instead of {len(pdu)}")


@case(812, "2.4", "a byte count one less or more is refused with 3, whichever data comes with it")
def every_byte_count(master: Master) -> None:
    for function, place, unit in ((15, 5, 1), (16, 5, 2), (23, 9, 2)):
        pdu = nowhere_requests()[function]
        for step in (-unit, -1, 1, unit):
            false = pdu[:place] + bytes([pdu[place] + step]) + pdu[place + 1 :]
            fitting = (false + bytes(2))[: len(pdu) + step]
            for each in (false, fitting):
                master.refused(each, VALUE, f"{function} with a byte count of {pdu[place] + step}")


@case(813, "2.5", "no word beside FF00 and 0000 switches a coil: 3")
def coil_words(master: Master) -> None:
    for word in (0x0001, 0x007F, 0x0100, 0x7F00, 0x8000, 0xFE00, 0xFF01, 0x00FF, 0xFFFF):
        pdu = struct.pack(">BHH", WRITE_COIL, NOWHERE, word)
        master.refused(pdu, VALUE, f"a coil with {word:#06x}")


@case(814, "2.6", "sub-function 0 takes whole words, every other one word that is zero, else 3")
def diagnostic_data(master: Master) -> None:
    for sub in (2, 10, 11, 12, 13, 14):
        for data in ("", "00", "0001", "0100", "0000 00", "0000 0000"):
            pdu = bytes([DIAGNOSTICS, 0, sub]) + bytes.fromhex(data)
            master.refused(pdu, VALUE, f"sub-function {sub} with {data or 'nothing'}")
    for size in (0, 1, 3, 5, 249):
        master.refused(bytes([DIAGNOSTICS, 0, 0]) + bytes(size), VALUE, f"sub-function 0 with {size} bytes")


@case(815, "2.6", "every sub-function that is not listed is refused with 1")
def other_sub_functions(master: Master) -> None:
    for sub in (*set(range(0x100)) - {0, 2, 10, 11, 12, 13, 14}, 0x0100, 0x0A00, 0x0B00, 0x8000):
        master.refused(struct.pack(">BHH", DIAGNOSTICS, sub, 0), FUNCTION, f"sub-function {sub:#x}")


REQUESTS, FRAMES, EXCEPTIONS, ADDRESSED = 11, 12, 13, 14
TRIES = 10
CLEAR = bytes([DIAGNOSTICS, 0, 10, 0, 0])


def least_growth(master: Master, sub_function: int, meanwhile: Callable[[], None]) -> int:
    """By how much a counter grows, at least, from one question to the next."""
    found = []
    for _ in range(TRIES):
        before = counter(master, sub_function)
        meanwhile()
        found.append((counter(master, sub_function) - before) % 0x10000)
    return min(found)


def _sound(master: Master) -> None:
    master.words(INPUTS, 1)
    master.ask(bytes.fromhex("08 0000 1234"))


def _make_refused_requests(master: Master) -> None:
    master.refused(b"\x07", FUNCTION, "function code 7")
    master.refused(read_request(READ_HOLDING, 0x7000, 1), ADDRESS, "an address")
    master.refused(read_request(READ_HOLDING, INPUTS, 0), VALUE, "a quantity")
    master.refused(bytes.fromhex("08 0063 0000"), FUNCTION, "a sub-function")


@case(821, "2.6", "sub-functions 11 and 14 count every request once, sound or refused")
def requests_counted(master: Master) -> None:
    for sub in (REQUESTS, ADDRESSED):
        for each, expected in ((_sound, 3), (_make_refused_requests, 5)):
            got = least_growth(master, sub, lambda each=each: each(master))  # type: ignore[misc]
            require(got == expected, f"sub-function {sub} grew by {got} with {expected} requests")


@case(822, "2.6", "sub-function 13 counts every exception once and nothing else")
def exceptions_counted(master: Master) -> None:
    for each, expected in ((_sound, 0), (_make_refused_requests, 4)):
        got = least_growth(master, EXCEPTIONS, lambda each=each: each(master))  # type: ignore[misc]
        require(got == expected, f"it grew by {got} with {expected} exceptions")


@case(823, "2.6", "sub-function 12 counts every frame that ends a connection and nothing else")
def frames_counted(master: Master) -> None:
    def lose(protocol: int, length: int) -> None:
        lost = master.second()
        lost.send_raw(FRAMING_HEAD.pack(1, protocol, length, 1) + READ_ONE)
        require(lost.is_closed(), "the connection lives on, or was answered on")

    before = counter(master, FRAMES)
    for protocol, length in ((1, 6), (0, 1), (0, 255)):
        lose(protocol, length)
    got = (counter(master, FRAMES) - before) % 0x10000
    require(got == 3, f"it grew by {got} with 3 such frames")
    _sound(master)
    _make_refused_requests(master)
    require((counter(master, FRAMES) - before) % 0x10000 == 3, "it counts other requests too")


@case(824, "2.6", "sub-function 10 clears every counter and gives its data back")
def counters_cleared(master: Master) -> None:
    lost = master.second()
    lost.send_raw(FRAMING_HEAD.pack(1, 1, 6, 1) + READ_ONE)
    require(lost.is_closed(), "the connection lives on, or was answered on")
    for sub, most in ((EXCEPTIONS, 0), (FRAMES, 0), (REQUESTS, 1), (ADDRESSED, 1)):
        found = []
        for _ in range(TRIES):
            _make_refused_requests(master)
            require(master.ask(CLEAR) == CLEAR, "the data did not come back")
            found.append(counter(master, sub))
        require(min(found) <= most, f"sub-function {sub} stands at {min(found)} right after clearing")


@case(825, "2.6", "sub-function 2 is the status word of the register")
def status_word(master: Master) -> None:
    for _ in range(TRIES):
        before, told, after = master.word(STATUS), counter(master, 2), master.word(STATUS)
        if before == after:
            require(told == before, f"sub-function 2 tells {told:#06x}, the register {before:#06x}")
            return
