"""Cases 631…: what lies at which address (clause 3)."""

import time

from conformance.case import coupler
from conformance.coupler.frames import ADDRESS
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
    IDENTIFICATION,
    STATUS,
    STATUS_CONFIGURATION,
    STATUS_TERMINAL_BUS,
    WATCHDOG_LEFT_MS,
    WATCHDOG_TIME_MS,
)

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
