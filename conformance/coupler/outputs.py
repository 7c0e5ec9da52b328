"""Cases 651…: writing outputs, and whose they are (clauses 2, 4); digital outputs move nothing."""

from conformance.case import coupler
from conformance.master import (
    INPUTS,
    OUTPUTS,
    READ_COILS,
    WRITE_COIL,
    WRITE_COILS,
    Master,
    exchange_request,
    word_request,
    write_request,
)
from conformance.wire import Unsupported, require
from protocol.coupler_registers import RESET_WORDS, WATCHDOG_RESET, WATCHDOG_TRIGGER

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
    for request, wanted in (("05 0002 FF00", 0xAAAE), ("05 0003 0000", 0xAAA6)):
        pdu = bytes.fromhex(request)
        require(master.ask(pdu) == pdu, "the answer is not the request")
        require(master.bits(READ_COILS, 0, 16) == wanted, f"after {request}: not {wanted:#06x}")


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
