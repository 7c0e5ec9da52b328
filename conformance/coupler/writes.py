"""Cases 851…: what writes change, and that refused ones change nothing (clauses 2.7 to 2.9)."""

import struct

from conformance.case import coupler
from conformance.coupler.frames import ADDRESS, VALUE
from conformance.coupler.limits import UNITS, coils_request
from conformance.coupler.outputs import every_write, spare_word
from conformance.coupler.reach import OWN, WRITABLE, blocks_of
from conformance.coupler.registers import input_words
from conformance.master import (
    INPUTS,
    ON,
    OUTPUTS,
    READ_COILS,
    WRITE_COIL,
    Master,
    exchange_request,
    read_request,
    word_request,
    write_request,
)
from conformance.wire import require
from protocol.coupler_registers import RESET_WORDS, WATCHDOG_RESET, WATCHDOG_TIME_MS, WATCHDOG_TRIGGER

case = coupler.case
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
    for address, bits, data, wanted in (
        (0, 16, "34 92", 0x9234), (0, 9, "FF FF", 0x01FF), (0, 9, "00 01", 0x0100), (0, 9, "FF 00", 0x00FF),
        (6, 5, "F5", 0x0540), (5, 10, "55 FF", 0x6AA0), (15, 1, "01", 0x8000),
    ):  # fmt: skip
        master.done(word_request(spare, 0), "zeroing the word")
        pdu = coils_request(address, bits, bytes.fromhex(data))
        require(master.ask(pdu) == pdu[:5], "the answer is not address and quantity")
        got = master.word(spare)
        require(
            got == wanted, f"{bits} coils from {address} on with {data}: {got:#06x}, wanted {wanted:#06x}"
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
    for pdu, wanted in (
        (coil_request(1), KEPT | 2), (coils_request(0, 1, b"\0"), KEPT & ~1 | 2), (word_request(spare, 7), 7)
    ):  # fmt: skip
        master.done(pdu, "a write")
        words[-1] = wanted if pdu[0] == 6 else master.word(spare)
        require(master.words(OUTPUTS, len(words)) == words, f"{pdu.hex()} changed another output")
    master.done(read_request(READ_COILS, 0, 16), "reading")


@case(860, "1.2", "the answers to every writing function code repeat transaction and unit", motion=True)
def units_of_writes(master: Master) -> None:
    spare = spare_word(master)
    for transaction, unit in zip((0, 0x1234, 0xFFFF), UNITS, strict=True):
        for pdu in every_write(spare):
            answer = master.ask(pdu, transaction=transaction, unit=unit)
            require(answer[0] == pdu[0], f"{pdu.hex()} was answered {answer.hex()}")
