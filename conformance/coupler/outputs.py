"""Cases 651…: writing outputs, and whose they are (clauses 2, 4); digital outputs move nothing."""

import struct

from conformance.case import coupler
from conformance.coupler.frames import ADDRESS, VALUE
from conformance.coupler.limits import UNITS, coils_request
from conformance.coupler.registers import OWN, WRITABLE, blocks_of, input_words
from conformance.master import (
    INPUTS,
    ON,
    OUTPUTS,
    READ_COILS,
    WRITE_COIL,
    WRITE_COILS,
    Master,
    exchange_request,
    read_request,
    word_request,
    write_request,
)
from conformance.wire import Unsupported, require
from protocol.coupler_registers import RESET_WORDS, WATCHDOG_RESET, WATCHDOG_TIME_MS, WATCHDOG_TRIGGER

case = coupler.case
OWNED = 6


def spare_word(master: Master, **watchdog: int) -> int:
    """The address of the first word of digital outputs, with the outputs taken; writing it moves nothing."""
    lengths = master.take_outputs(**watchdog)
    if lengths.digital_outputs < 16:
        raise Unsupported("fewer than 16 digital outputs")
    return OUTPUTS + lengths.analog_outputs


def every_write(spare: int) -> list[bytes]:
    """A writing request of each function code."""
    return [
        bytes([WRITE_COIL]) + bytes.fromhex("0000 FF00"),
        word_request(spare, 1),
        bytes([WRITE_COILS]) + bytes.fromhex("0000 0001 01 01"),
        write_request(spare, [1]),
        exchange_request(INPUTS, 1, spare, [1]),
    ]


@case(651, "2.7", "a word written with 6 is repeated in the answer and read back", motion=True)
def single_register(master: Master) -> None:
    spare = spare_word(master)
    request = word_request(spare, 0xA55A)
    require(master.ask(request) == request, "the answer is not the request")
    require(master.word(spare) == 0xA55A, "read back as another word")


@case(652, "2.7", "words written with 16 are read back, the answer names address and quantity", motion=True)
def several_registers(master: Master) -> None:
    spare = spare_word(master)
    request = write_request(spare, [0x1234])
    require(master.ask(request) == request[:5], "the answer is not address and quantity")
    require(master.word(spare) == 0x1234, "read back as another word")


@case(653, "2.7", "a coil is switched on and off and no other with it", motion=True)
def single_coil(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 0xAAAA), "writing the word")
    for request, expected in (("05 0002 FF00", 0xAAAE), ("05 0003 0000", 0xAAA6)):
        pdu = bytes.fromhex(request)
        require(master.ask(pdu) == pdu, "the answer is not the request")
        require(master.bits(READ_COILS, 0, 16) == expected, f"after {request}: not {expected:#06x}")


@case(654, "2.7", "several coils are written, those beyond the quantity are left", motion=True)
def several_coils(master: Master) -> None:
    spare = spare_word(master)
    pdu = bytes.fromhex("0F 0002 0003 01 FD")
    require(master.ask(pdu) == pdu[:5], "the answer is not address and quantity")
    require(master.bits(READ_COILS, 0, 16) == 0b10100, "not the three coils alone")
    require(master.word(spare) == 0b10100, "coils and word differ")


@case(655, "2.8", "function code 23 writes before it reads", motion=True)
def write_before_read(master: Master) -> None:
    spare = spare_word(master)
    for word in (0x5AA5, 0x0FF0):
        answer = master.done(exchange_request(spare, 1, spare, [word]), "an exchange")
        require(
            answer[1:] == b"\2" + word.to_bytes(2, "big"), f"{word:#06x} written, {answer[2:].hex()} read"
        )


@case(656, "2.8", "the published exchange: two words read, two written", motion=True)
def published_exchange(master: Master) -> None:
    lengths = master.take_outputs()
    if lengths.analog_outputs < 2:
        raise Unsupported("fewer than two analog outputs")
    answer = master.done(bytes.fromhex("17 0000 0002 0800 0002 04 3FFF 7FFF"), "the published exchange")
    require(len(answer) == 6 and answer[1] == 4, f"answered {answer.hex()}")
    require(master.words(OUTPUTS, 2) == [0x3FFF, 0x7FFF], "the outputs are not those written")


@case(657, "2.9", "a refused exchange writes nothing", motion=True)
def refused_whole(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 0x1111), "writing the word")
    master.refused(exchange_request(0x0700, 1, spare, [0x2222]), 2, "reading where nothing is")
    require(master.word(spare) == 0x1111, "a refused exchange has written")


@case(658, "2.9", "a refused write changes nothing, not even its sound part", motion=True)
def beyond_the_end(master: Master) -> None:
    spare = spare_word(master)
    lengths = master.lengths()
    last = OUTPUTS + lengths.analog_outputs + (lengths.digital_outputs + 15) // 16 - 1
    master.done(word_request(spare, 0x1111), "writing the word")
    master.refused(write_request(last, [0x2222, 0x2222]), 2, "writing beyond the end")
    require(master.word(spare) == 0x1111, "a refused write has written")


@case(661, "4.2", "a second master that writes is refused with 6, with every function code", motion=True)
def second_master(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 0x8000), "writing the word")
    other = master.second()
    for request in every_write(spare):
        other.refused(request, OWNED, f"function code {request[0]} of a second master")
    require(master.word(spare) == 0x8000, "a refused master has written")


@case(662, "4.2", "a second master may read", motion=True)
def second_reader(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 0x0F0F), "writing the word")
    other = master.second()
    require(other.word(spare) == 0x0F0F, "it reads other outputs")
    other.words(INPUTS, 1)


@case(663, "4.2", "the refused second master does not disturb the first", motion=True)
def first_goes_on(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 1), "writing the word")
    other = master.second()
    for number in range(10):
        other.refused(word_request(spare, 0), OWNED, "a second master")
        master.done(word_request(spare, number), "the first master's write")


@case(664, "4.3", "once the owner has hung up, another master may write", motion=True)
def owner_leaves(master: Master) -> None:
    spare = spare_word(master)
    owner = master.second()
    owner.done(word_request(spare, 1), "the owner's write")
    owner.hang_up()
    for _ in range(200):
        if len(master.ask(word_request(spare, 2))) == 5:
            return
    require(False, "the outputs still belong to a master that has gone")


@case(665, "4.2", "a second master may not set or reset the owner's watchdog", motion=True)
def owners_watchdog(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 1), "the owner's write")
    other = master.second()
    for word in RESET_WORDS:
        other.refused(word_request(WATCHDOG_RESET, word), OWNED, "a second master's reset")
    other.refused(word_request(WATCHDOG_TRIGGER, 0), OWNED, "a second master's setting")
    master.done(word_request(spare, 1), "the owner's write after it")


KEPT = 0x1111
NOWHERE = 0x7000


def coil_request(number: int, word: int = ON) -> bytes:
    """A request of function code 5."""
    return struct.pack(">BHH", WRITE_COIL, number, word)


@case(851, "2.7", "every coil is switched alone, up to the last", motion=True)
def each_coil(master: Master) -> None:
    spare = spare_word(master)
    for number in range(16):
        master.done(word_request(spare, 0), "zeroing the word")
        pdu = coil_request(number)
        require(master.ask(pdu) == pdu, "the answer is not the request")
        got = master.word(spare)
        require(got == 1 << number, f"coil {number} on: the word is {got:#06x}")


@case(852, "2.7", "coils are written over the border of two bytes, and to the last one", motion=True)
def coils_over_bytes(master: Master) -> None:
    spare = spare_word(master)
    for address, bits, data, expected in (
        (0, 16, "34 92", 0x9234), (0, 9, "FF FF", 0x01FF), (0, 9, "00 01", 0x0100), (0, 9, "FF 00", 0x00FF),
        (6, 5, "F5", 0x0540), (5, 10, "55 FF", 0x6AA0), (15, 1, "01", 0x8000),
    ):  # fmt: skip
        master.done(word_request(spare, 0), "zeroing the word")
        pdu = coils_request(address, bits, bytes.fromhex(data))
        require(master.ask(pdu) == pdu[:5], "the answer is not address and quantity")
        got = master.word(spare)
        require(
            got == expected, f"{bits} coils from {address} on with {data}: {got:#06x}, wanted {expected:#06x}"
        )


@case(853, "2.7", "the whole output image is written with 16, and with 23, and read back", motion=True)
def whole_output_image(master: Master) -> None:
    spare = spare_word(master)
    for word in (0x5AA5, 0x0FF0):
        words = [0] * (spare - OUTPUTS) + [word]
        pdu = write_request(OUTPUTS, words)
        require(master.ask(pdu) == pdu[:5], "the answer is not address and quantity")
        require(master.words(OUTPUTS, len(words)) == words, "read back as other words")
        words[-1] = word ^ 0xFFFF
        answer = master.done(exchange_request(OUTPUTS, len(words), OUTPUTS, words), "an exchange")
        require(answer[2:] == struct.pack(f">{len(words)}H", *words), "it reads other words than it wrote")


@case(854, "3.7", "the bits that fill up the last byte of coils are zero, with all coils on", motion=True)
def fill_bits_of_coils(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, 0xFFFF), "switching all on")
    for bits in range(1, 17):
        require(master.bits(READ_COILS, 0, bits) == (1 << bits) - 1, f"{bits} coils, not they alone")
        require(master.bits(READ_COILS, 16 - bits, 1) == 1, f"coil {16 - bits} is not read alone")


@case(
    855,
    "3.1",
    "function code 23 reads inputs, outputs and own registers, and no word beside them",
    motion=True,
)
def read_by_exchange(master: Master) -> None:
    spare = spare_word(master)
    blocks = [range(INPUTS, INPUTS + input_words(master)), range(OUTPUTS, spare + 1), *blocks_of(OWN)]
    for block in blocks:
        answer = master.done(exchange_request(block.start, len(block), spare, [1]), f"{block} with 23")
        require(answer[1] == 2 * len(block) == len(answer) - 2, f"{block}: answered {answer.hex()}")
        for address, size in ((block.stop, 1), (block.start, len(block) + 1)):
            master.refused(exchange_request(address, size, spare, [1]), ADDRESS, f"{size} at {address:#06x}")
        if block.start:
            pdu = exchange_request(block.start - 1, 2, spare, [1])
            master.refused(pdu, ADDRESS, f"2 at {block.start - 1:#06x}")


@case(856, "3.1", "the writable own registers are written with 6 and with 16", motion=True)
def own_registers_written(master: Master) -> None:
    master.take_outputs()
    resets = [(WATCHDOG_RESET, word) for word in RESET_WORDS]
    settings = [
        (WATCHDOG_TIME_MS, 777),
        (WATCHDOG_TRIGGER, 0),
        (WATCHDOG_TIME_MS, 1000),
        (WATCHDOG_TRIGGER, 1),
    ]
    for make in (word_request, lambda address, word: write_request(address, [word])):
        for address, word in (*settings, *resets):
            pdu = make(address, word)
            require(master.ask(pdu) == pdu[:5], f"{address:#06x} with {pdu[0]}")
            require(master.word(address) == word, f"{address:#06x}, written with {pdu[0]}, is another word")


def refused_writes(spare: int) -> list[tuple[bytes, int]]:
    """Writes whose sound part would change the word at ``spare``, and the exception that each deserves."""
    other = [0x2222]
    sound = {
        6: word_request(spare, *other), 16: write_request(spare, other),
        23: exchange_request(INPUTS, 1, spare, other), 5: coil_request(1), 15: coils_request(8, 8, b"\xff"),
    }  # fmt: skip
    count_at = {16: 5, 15: 5, 23: 9}
    wrong = [(pdu + b"\0", VALUE) for pdu in sound.values()]
    wrong += [(pdu[:-1], VALUE) for pdu in sound.values()]
    for function, place in count_at.items():
        pdu = sound[function]
        wrong += [(pdu[:place] + bytes([pdu[place] + step]) + pdu[place + 1 :], VALUE) for step in (-1, 1)]
    head = struct.pack(">BHHHHB", 23, INPUTS, 1, spare, 1, 2)[1:]
    for count in (0, 126, 0xFFFF):
        wrong.append((b"\x17" + head[:2] + struct.pack(">H", count) + head[4:] + b"\x22\x22", VALUE))
    wrong += [(exchange_request(NOWHERE, 1, spare, other), ADDRESS), (coil_request(1, 0x1234), VALUE)]
    wrong += [
        (exchange_request(INPUTS, 1, spare, other * 2), ADDRESS),
        (write_request(spare, other * 2), ADDRESS),
    ]
    wrong += [(coils_request(8, 9, b"\xff\xff"), ADDRESS), (coils_request(0, 17, b"\xff\xff\xff"), ADDRESS)]
    return wrong


@case(857, "2.9", "no refused write changes an output, whatever is wrong with it", motion=True)
def refused_writes_change_nothing(master: Master) -> None:
    spare = spare_word(master)
    master.done(word_request(spare, KEPT), "writing the word")
    for pdu, code in refused_writes(spare):
        master.refused(pdu, code, f"{pdu.hex()}")
        got = master.word(spare)
        require(got == KEPT, f"{pdu.hex()} was refused, and the word is {got:#06x}")


@case(858, "2.9", "no refused write changes an own register", motion=True)
def refused_settings_change_nothing(master: Master) -> None:
    master.take_outputs(watchdog_ms=777)
    master.reset()
    kept = [master.word(address) for address in WRITABLE]
    for pdu, code in (
        (word_request(WATCHDOG_TRIGGER, 2), VALUE), (write_request(WATCHDOG_TRIGGER, [2]), VALUE),
        (word_request(WATCHDOG_RESET, 0x1234), VALUE),
        (word_request(WATCHDOG_RESET, RESET_WORDS[1]), VALUE),
        (word_request(WATCHDOG_TIME_MS, 5) + b"\0", VALUE),
        (write_request(WATCHDOG_TIME_MS, [5, 5]), ADDRESS),
        (exchange_request(INPUTS, 1, WATCHDOG_TIME_MS, [5]), ADDRESS),
        (word_request(WATCHDOG_TRIGGER, 0)[:-1], VALUE),
    ):  # fmt: skip
        master.refused(pdu, code, pdu.hex())
        require(
            [master.word(address) for address in WRITABLE] == kept, f"{pdu.hex()} was refused, and changed"
        )


@case(
    859, "2.7", "a coil that is written leaves the analog outputs, and a word leaves the others", motion=True
)
def neighbours_stay(master: Master) -> None:
    spare = spare_word(master)
    words = [0] * (spare - OUTPUTS) + [KEPT]
    for pdu, expected in (
        (coil_request(1), KEPT | 2), (coils_request(0, 1, b"\0"), KEPT & ~1 | 2), (word_request(spare, 7), 7)
    ):  # fmt: skip
        master.done(pdu, "a write")
        words[-1] = expected if pdu[0] == 6 else master.word(spare)
        require(master.words(OUTPUTS, len(words)) == words, f"{pdu.hex()} changed another output")
    master.done(read_request(READ_COILS, 0, 16), "reading")


@case(860, "1.2", "the answers to every writing function code repeat transaction and unit", motion=True)
def units_of_writes(master: Master) -> None:
    spare = spare_word(master)
    for transaction, unit in zip((0, 0x1234, 0xFFFF), UNITS, strict=True):
        for pdu in every_write(spare):
            answer = master.ask(pdu, transaction=transaction, unit=unit)
            require(answer[0] == pdu[0], f"{pdu.hex()} was answered {answer.hex()}")
