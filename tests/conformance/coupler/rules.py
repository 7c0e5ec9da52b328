"""What docs/process_image.md leaves no choice about, as data: a broken coupler is one with a rule changed."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

READING, WRITING = (1, 2, 3, 4), (5, 6, 15, 16, 23)
EVERY_REGISTER = (0x1000, 7), (0x100C, 1), (0x1010, 4), (0x1020, 1), (0x1120, 3)
OWN_WRITABLE = (0x1120, 1), (0x1121, 1), (0x1122, 1)
INPUTS, OUTPUTS = (0x0000, 41), (0x0800, 13)
TIME, RESET, TRIGGER = 0x1120, 0x1121, 0x1122
MS = 1_000_000

Spans = tuple[tuple[int, int], ...]

# What a telegram can be to the watchdog: a function code on the image, on the own registers, or refused.
IMAGE_READS = frozenset({"1", "2", "3", "4"})
IMAGE_WRITES = frozenset({"5", "6", "15", "16", "23"})
OTHERS = frozenset({"3 own", "4 own", "6 own", "16 own", "8"})
CARRIED_OUT = IMAGE_READS | IMAGE_WRITES | OTHERS
REFUSED = frozenset({"refused 1", "refused 2", "refused 3"})


def _same_header(transaction: int, unit: int, pdu: bytes) -> tuple[int, int]:
    return transaction, unit


def _refusal(function: int, code: int) -> bytes:
    return bytes([function | 0x80, code])


def _short_answer(pdu: bytes) -> bytes:
    return pdu[:5]


def _delivered(function: int, words: list[int]) -> list[int]:
    return words


def _left_ms(left_ns: int, time_ms: int) -> int:
    return max(-(-left_ns // MS), 0)


def _name(reads: int) -> bytes:
    return b"PAGE COUPLER\0\0"


class Rules(NamedTuple):
    """The sound coupler; each field is one clause or a part of it, in their order."""

    # 1.1 to 1.4
    connections: int = 32
    header: Callable[[int, int, bytes], tuple[int, int]] = _same_header
    waits_for_the_whole: bool = True
    answers_of_a_piece: int = 1000
    in_order: bool = True
    least_length: int = 2
    most_length: int = 254
    protocol_bits: int = 0xFFFF
    answers_what_is_lost: bool = False
    closes_what_is_lost: bool = True
    answers_before_it: bool = True
    one_ends_all: frozenset[str] = frozenset()
    # 2.1 to 2.4
    functions: frozenset[int] = frozenset((*READING, *WRITING, 8))
    refusal: Callable[[int, int], bytes] = _refusal
    order: tuple[str, ...] = ("function", "length", "address", "watchdog", "owner", "value")
    order_of: Mapping[int, tuple[str, ...]] = {}
    least: Mapping[int, int] = {}
    most_read: Mapping[int, int] = {1: 2000, 2: 2000, 3: 125, 4: 125, 23: 125}
    most_written: Mapping[int, int] = {15: 1968, 16: 123, 23: 121}
    no_check: frozenset[tuple[str, int]] = frozenset()
    # 2.5 to 2.8
    coil_words: Mapping[int, bool] = {0xFF00: True, 0x0000: False}
    sub_functions: Mapping[int, str] = {
        0: "echo", 2: "status", 10: "clear", 11: "requests", 12: "frames", 13: "exceptions", 14: "requests",
    }  # fmt: skip
    data_before_sub_function: bool = False
    zero_data: frozenset[int] = frozenset({2, 10, 11, 12, 13, 14})
    cleared: frozenset[str] = frozenset({"requests", "frames", "exceptions"})
    counted: frozenset[str] = frozenset({"requests", "refused requests", "frames", "exceptions"})
    echoes: Callable[[bytes], bytes] = bytes
    short_answer: Callable[[bytes], bytes] = _short_answer
    coil_from: Callable[[int], int] = int
    coil_place: Callable[[int], int] = int
    coil_clears_others: bool = False
    bits_beyond: bool = False
    writes_first: bool = True
    # 2.9
    refused_but_written: frozenset[tuple[int, int]] = frozenset()
    spools: tuple[int, int] = (0x0802, 6)
    spools_of_torn_images: bool = True
    torn_is_kept: bool = True
    torn_acts: bool = False
    # 3.1 to 3.7
    reads: Mapping[int, Spans] = {
        1: ((0, 16),),
        2: ((0, 16),),
        3: (INPUTS, OUTPUTS, *EVERY_REGISTER),
        4: (INPUTS, *EVERY_REGISTER),
        23: (INPUTS, OUTPUTS, *EVERY_REGISTER),
    }
    writes: Mapping[int, Spans] = {
        5: ((0, 16),),
        6: (OUTPUTS, *OWN_WRITABLE),
        15: ((0, 16),),
        16: (OUTPUTS, *OWN_WRITABLE),
        23: (OUTPUTS,),
    }
    delivers: Callable[[int, list[int]], list[int]] = _delivered
    of_the_request_before: frozenset[int] = frozenset()
    name: Callable[[int], bytes] = _name
    status: int = 0
    status_expired: int = 0x8000
    lengths: tuple[int, int, int, int] = (192, 640, 16, 16)
    fills_with: Mapping[int, int] = {}
    digital_inputs: Callable[[int], int] = int
    # 4.1 to 4.3
    owning: frozenset[int] = frozenset(WRITING)
    guarded: frozenset[int] = frozenset((*WRITING, TIME, RESET, TRIGGER))
    closed_to_others: frozenset[str] = frozenset()
    refused_changes_owner: bool = False
    released_by: frozenset[str] = frozenset({"close", "expiry", "reset", "silence"})
    release_ms: int = 1000
    release_counts_reads: bool = False
    # 5.1 to 5.3
    time_when_active: int = 4
    time_when_expired: int = 4
    off_up_to_ms: int = 0
    arming: frozenset[str] = IMAGE_WRITES
    feeding: Mapping[int, frozenset[str]] = {1: CARRIED_OUT, 0: IMAGE_WRITES}
    feeding_of_others: frozenset[str] = frozenset()
    triggers: frozenset[int] = frozenset({0, 1})
    time_ns: Callable[[int], int] = MS.__mul__
    # 5.4
    zeroes: frozenset[str] = frozenset({"analog", "digital"})
    zeroes_act: bool = True
    silenced: frozenset[int] = frozenset((*READING, *WRITING))
    silences: str = "everybody"
    own_after_expiry: bool = True
    cleared_by: frozenset[str] = frozenset()
    # 5.5
    reset_words: tuple[int, int] = (0xBECF, 0xAFFE)
    reset_by: frozenset[str] = frozenset({"pair"})
    begins_anew: bool = True
    spoiled_by_words: bool = True
    spoiled_by_requests: bool = False
    of_one_master: bool = True
    spoiled_by_others: bool = True
    forgets_the_first: bool = True
    other_word: int = 3
    reset_clears: frozenset[str] = frozenset({"latch", "armed"})
    reads_the_last: bool = True
    forgotten: frozenset[tuple[str, str]] = frozenset()
    # 5.6 and 5.7
    left_ms: Callable[[int, int], int] = _left_ms
    left_when_inactive: int = 0
    closing: str = ""
    # protocol.md, 10.3 to 10.7
    layout: int = 0x4C01
    reserved: int = 0
    last_word_apart: int = 0
    cycles: bool = True
    echo: str = "whole"
    takes_zeros: bool = True
    motion_ms: float = 100.0
    trip_is_cleared_by: frozenset[str] = frozenset({"edge"})
    tripped_bit: int = 0x0004
