"""Cases 631…: what lies at which address (clause 3)."""

import time

from conformance.case import coupler
from conformance.coupler.frames import ADDRESS, VALUE
from conformance.coupler.limits import coils_request
from conformance.master import (
    EXCHANGE,
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
from conformance.wire import Unsupported, require
from protocol.coupler_registers import (
    ANALOG_OUTPUT_BITS,
    COUPLER_TABLE,
    IDENTIFICATION,
    STATUS,
    STATUS_CONFIGURATION,
    STATUS_TERMINAL_BUS,
    WATCHDOG_LEFT_MS,
    WATCHDOG_TIME_MS,
)
from protocol.process_image import INPUT_LAYOUT, INPUT_TABLE, INPUT_WORDS

case = coupler.case


def input_words(master: Master) -> int:
    """Registers of the input image."""
    lengths = master.lengths()
    return lengths.analog_inputs + (lengths.digital_inputs + 15) // 16


def output_words(master: Master) -> int:
    """Registers of the output image."""
    lengths = master.lengths()
    return lengths.analog_outputs + (lengths.digital_outputs + 15) // 16


@case(631, "3.2", "the identification is seven words of printable text that stay the same")
def identification(master: Master) -> None:
    words = master.words(IDENTIFICATION, 7)
    text = b"".join(word.to_bytes(2, "little") for word in words).rstrip(b"\0 ")
    require(bool(text) and all(32 <= byte < 127 for byte in text), f"not printable: {text.hex()}")
    require(master.words(IDENTIFICATION, 7) == words, "it changed")


@case(632, "3.3", "the status tells of no terminal bus error and no configuration error")
def status(master: Master) -> None:
    word = master.word(STATUS)
    require(word & (STATUS_TERMINAL_BUS | STATUS_CONFIGURATION) == 0, f"status {word:#06x}")


@case(633, "3.4", "the lengths are whole words of analog terminals and no more than the map holds")
def image_lengths(master: Master) -> None:
    analog_out, analog_in, digital_out, digital_in = master.words(ANALOG_OUTPUT_BITS, 4)
    require(analog_out % 16 == analog_in % 16 == 0, "analog terminals that are not whole words")
    require(analog_in + digital_in > 0, "no inputs at all")
    require(max(analog_out + digital_out, analog_in + digital_in) <= 16 * 256, "longer than 256 words")


@case(634, "3.4", "the whole input image is read with 3 and 4, one word more is refused with 2")
def input_length(master: Master) -> None:
    count = input_words(master)
    if count > 125:
        raise Unsupported("an image longer than one request")
    for function in (READ_HOLDING, READ_INPUT):
        master.words(INPUTS, count, function)
        master.refused(read_request(function, INPUTS, count + 1), ADDRESS, f"{count + 1} input words")
        master.refused(read_request(function, INPUTS + count, 1), ADDRESS, "the word behind the inputs")


@case(635, "3.4", "the whole output image is read with 3, one word more is refused with 2")
def output_length(master: Master) -> None:
    count = output_words(master)
    if not 0 < count <= 125:
        raise Unsupported("no output image, or longer than one request")
    master.words(OUTPUTS, count)
    master.refused(read_request(READ_HOLDING, OUTPUTS, count + 1), ADDRESS, f"{count + 1} output words")
    master.refused(read_request(READ_HOLDING, OUTPUTS - 1, 2), ADDRESS, "a word before the outputs")


@case(636, "3.1", "function code 4 does not read outputs: 2")
def inputs_only(master: Master) -> None:
    master.refused(read_request(READ_INPUT, OUTPUTS, 1), ADDRESS, "an output with function code 4")


@case(637, "3.4", "bits beyond the digital terminals are refused with 2")
def bit_lengths(master: Master) -> None:
    lengths = master.lengths()
    for function, count in ((READ_COILS, lengths.digital_outputs), (READ_DISCRETE, lengths.digital_inputs)):
        master.refused(read_request(function, 0, count + 1), ADDRESS, f"{count + 1} bits with {function}")
        master.refused(read_request(function, count, 1), ADDRESS, f"bit {count} with {function}")
        master.refused(read_request(function, 0xFFFF, 1), ADDRESS, f"bit 65535 with {function}")


@case(638, "3.5", "addresses between the blocks are refused with 2")
def gaps(master: Master) -> None:
    for address in (0x0700, 0x0900, 0x0FFF, 0x1007, 0x100D, 0x1014, 0x2000, 0x7FFF, 0xFFFF):
        master.refused(read_request(READ_HOLDING, address, 1), ADDRESS, f"register {address:#06x}")


@case(639, "3.5", "a request that begins in one block and ends outside it is refused with 2")
def crossing(master: Master) -> None:
    for address, count in ((IDENTIFICATION, 8), (IDENTIFICATION - 1, 2), (STATUS, 2), (0xFFFF, 2)):
        master.refused(read_request(READ_HOLDING, address, count), ADDRESS, f"{count} at {address:#06x}")


@case(640, "3.6", "what is read only is not written: 2")
def read_only(master: Master) -> None:
    for address in (INPUTS, IDENTIFICATION, STATUS, ANALOG_OUTPUT_BITS, WATCHDOG_LEFT_MS):
        master.refused(word_request(address, 0), ADDRESS, f"writing {address:#06x} with 6")
        master.refused(write_request(address, [0]), ADDRESS, f"writing {address:#06x} with 16")
        master.refused(exchange_request(INPUTS, 1, address, [0]), ADDRESS, f"writing {address:#06x} with 23")


@case(641, "3.6", "function code 23 writes outputs only: 2 for the coupler's own registers")
def exchange_writes_outputs(master: Master) -> None:
    request = exchange_request(INPUTS, 1, WATCHDOG_TIME_MS, [1000])
    require(request[0] == EXCHANGE, "built wrongly")
    master.refused(request, ADDRESS, "the watchdog's time with 23")


@case(642, "3.7", "digital inputs lie behind the analog inputs: the same bits with 2 and with 3")
def digital_behind_analog(master: Master) -> None:
    lengths = master.lengths()
    if lengths.digital_inputs == 0:
        raise Unsupported("no digital inputs")
    count = min(lengths.digital_inputs, 16)
    for _ in range(3):
        before = master.bits(READ_DISCRETE, 0, count)
        word = master.word(INPUTS + lengths.analog_inputs) & (1 << count) - 1
        if before == master.bits(READ_DISCRETE, 0, count):  # they stood still meanwhile
            require(word == before, f"bits {before:#x}, word {word:#x}")
            return
        time.sleep(0.05)
    raise Unsupported("the digital inputs never stand still")


@case(643, "3.7", "bits that fill the last byte up are zero")
def spare_bits(master: Master) -> None:
    count = min(master.lengths().digital_inputs, 3)
    if count == 0:
        raise Unsupported("no digital inputs")
    require(master.bits(READ_DISCRETE, 0, count) < 1 << count, "spare bits are set")


OWN = [row.address + at for row in COUPLER_TABLE for at in range(row.words)]
WRITABLE = [row.address for row in COUPLER_TABLE if row.writable]
CHANGING = (STATUS, WATCHDOG_LEFT_MS)
STATUS_WORD = next(row.address for row in INPUT_TABLE if row.name == "status")
TRIES = 10


def blocks_of(addresses: list[int]) -> list[range]:
    """Addresses that follow each other, as ranges."""
    blocks: list[range] = []
    for address in sorted(addresses):
        if blocks and blocks[-1].stop == address:
            blocks[-1] = range(blocks[-1].start, address + 1)
        else:
            blocks.append(range(address, address + 1))
    return blocks


def plant_words(master: Master) -> list[int]:
    """The inputs with the digital ones behind them; raises Unsupported for another plant's.

    Raises Failed where the two functions that read them disagree on which plant's they are.
    """
    if input_words(master) < INPUT_WORDS:
        raise Unsupported("inputs of another plant")
    words = master.words(INPUTS, input_words(master))
    layouts = words[1], master.words(INPUTS + 1, 1, READ_INPUT)[0]
    require(layouts[0] == layouts[1], f"layout {layouts[0]:#06x} with 3, {layouts[1]:#06x} with 4")
    if words[1] != INPUT_LAYOUT:
        raise Unsupported("inputs of another plant")
    return words


@case(831, "3.1", "every own register is read with 3 and with 4, one by one and as a block")
def own_registers_read(master: Master) -> None:
    for function in (READ_HOLDING, READ_INPUT):
        for block in blocks_of(OWN):
            words = master.words(block.start, len(block), function)
            for address, word in zip(block, words, strict=True):
                alone = master.words(address, 1, function)[0]
                require(
                    address in CHANGING or alone == word, f"{address:#06x} with {function}: {alone}, {word}"
                )


@case(832, "3.5", "the words beside the own registers are refused with 2, alone and along with them")
def beside_own_registers(master: Master) -> None:
    for function in (READ_HOLDING, READ_INPUT):
        for block in blocks_of(OWN):
            for address, size in (
                (block.start - 1, 1),
                (block.stop, 1),
                (block.start - 1, len(block) + 1),
                (block.start, len(block) + 1),
            ):
                pdu = read_request(function, address, size)
                master.refused(pdu, ADDRESS, f"{size} at {address:#06x} with {function}")


@case(833, "3.6", "no read-only register is written with 6, 16 or 23: 2")
def read_only_registers(master: Master) -> None:
    count = input_words(master)
    inputs = [INPUTS, INPUTS + 1, INPUTS + count - 1]
    for address in inputs + [each for each in OWN if each not in WRITABLE]:
        for pdu in (
            word_request(address, 0), write_request(address, [0]), exchange_request(INPUTS, 1, address, [0])
        ):  # fmt: skip
            master.refused(pdu, ADDRESS, f"writing {address:#06x} with {pdu[0]}")


@case(834, "3.6", "own registers are written one by one, none with 23, and no word beside them: 2")
def own_registers_written(master: Master) -> None:
    for block in blocks_of(OWN):
        for address in (block.start - 1, block.stop):
            master.refused(word_request(address, 0), ADDRESS, f"writing {address:#06x} with 6")
            master.refused(write_request(address, [0]), ADDRESS, f"writing {address:#06x} with 16")
    for address in WRITABLE:
        pdu = exchange_request(INPUTS, 1, address, [0])
        master.refused(pdu, ADDRESS, f"writing {address:#06x} with 23")
        master.refused(write_request(address - 1, [0, 0]), ADDRESS, f"two words that end at {address:#06x}")
        master.refused(write_request(address, [0, 0]), ADDRESS, f"two words at {address:#06x}")


@case(835, "3.5", "the words beside the outputs are refused with 2, alone and along with them")
def beside_outputs(master: Master) -> None:
    count = output_words(master)
    for address, size in ((OUTPUTS - 1, 1), (OUTPUTS + count, 1), (OUTPUTS - 1, 2), (OUTPUTS + count - 1, 2)):
        what = f"{size} at {address:#06x}"
        if size == 1:
            master.refused(word_request(address, 0), ADDRESS, f"writing {what} with 6")
        master.refused(write_request(address, [0] * size), ADDRESS, f"writing {what} with 16")
        exchange = exchange_request(INPUTS, 1, address, [0] * size)
        master.refused(exchange, ADDRESS, f"writing {what} with 23")
        master.refused(read_request(READ_HOLDING, address, size), ADDRESS, f"reading {what} with 3")


@case(836, "3.1", "function code 4 reads none of the outputs: 2")
def outputs_are_no_inputs(master: Master) -> None:
    for address in range(OUTPUTS, OUTPUTS + output_words(master)):
        master.refused(read_request(READ_INPUT, address, 1), ADDRESS, f"{address:#06x} with 4")


@case(837, "3.4", "coils beyond the digital outputs are written neither with 5 nor with 15: 2")
def coils_beyond(master: Master) -> None:
    count = master.lengths().digital_outputs
    for address in (count, 0xFFFF):
        master.refused(bytes([5]) + address.to_bytes(2, "big") + b"\0\0", ADDRESS, f"coil {address} with 5")
        master.refused(coils_request(address, 1, b"\0"), ADDRESS, f"coil {address} with 15")
    if count:
        master.refused(coils_request(count - 1, 2, b"\0"), ADDRESS, "the last coil and one more with 15")
        master.refused(
            coils_request(0, count + 1, bytes(count // 8 + 1)), ADDRESS, f"{count + 1} coils with 15"
        )


@case(838, "3.7", "every digital input is found at its own address")
def each_digital_input(master: Master) -> None:
    size = master.lengths().digital_inputs
    if size == 0:
        raise Unsupported("no digital inputs")
    for _ in range(TRIES):
        before = master.bits(READ_DISCRETE, 0, size)
        alone = sum(master.bits(READ_DISCRETE, at, 1) << at for at in range(size))
        if before == master.bits(READ_DISCRETE, 0, size):  # they stood still meanwhile
            require(alone == before, f"one by one {alone:#x}, together {before:#x}")
            return
    raise Unsupported("the digital inputs never stand still")


@case(839, "3.7", "the bits that fill up the last byte are zero, however many are read")
def fill_bits(master: Master) -> None:
    lengths = master.lengths()
    for function, size in ((READ_COILS, lengths.digital_outputs), (READ_DISCRETE, lengths.digital_inputs)):
        for bits in range(1, min(size, 40) + 1):
            require(master.bits(function, 0, bits) < 1 << bits, f"{bits} bits with {function}: more are set")


@case(840, "3.7", "the digital inputs repeat the register status, in the same exchange")
def digital_inputs_of_this_plant(master: Master) -> None:
    words = plant_words(master)
    require(len(words) > INPUT_WORDS, "no digital inputs behind the analog ones")
    require(words[INPUT_WORDS] == words[STATUS_WORD], f"{words[INPUT_WORDS]:#x}, {words[STATUS_WORD]:#x}")


@case(841, "3.2", "the identification is the same in one piece, word by word and to every master")
def one_identification(master: Master) -> None:
    words = master.words(OWN[0], 7)
    other = master.second()
    for _ in range(TRIES):
        require([other.word(OWN[0] + at) for at in range(7)] == words, "it changed")
    require(words[0] != 0, "it is empty")


@case(842, "2.2", "the address is judged after the length for own registers too")
def order_for_own_registers(master: Master) -> None:
    master.refused(read_request(READ_HOLDING, OWN[0], 126), VALUE, "126 own registers")
    master.refused(write_request(OWN[0], [0])[:-1], VALUE, "a read-only register, one byte short")
