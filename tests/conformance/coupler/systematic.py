"""Broken couplers made by rule: every limit, address, order, timer, trigger and kept value of the page.

Each is the page's coupler with one rule changed, under the clause that it breaks. ``unseen`` says of one that
no case can catch it why not.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

from tests.conformance.coupler.rules import (
    CARRIED_OUT,
    IMAGE_READS,
    IMAGE_WRITES,
    INPUTS,
    MS,
    OUTPUTS,
    READING,
    REFUSED,
    RESET,
    TIME,
    TRIGGER,
    WRITING,
    Rules,
    Spans,
)

SOUND = Rules()
NO_OWNER = "an expired coupler has no owner, so both are never wrong at once"
NO_LENGTH = "a function code that is not listed has no length of its own"
ZERO_COUNT = "what is missing counts as zero, and a quantity of 0 is refused with 3 as well"
NOTHING_THERE = "where the one word or coil would be written is nothing"
TOO_LONG = "a frame has no room for one register more"
HIDDEN_NAME = "any text is a sound identification; the first letter of a foreign one is not known"
OTHER_PLANT = "with another layout word it is another plant, and the cases of this one are unsupported"
ONE_WORD = "6 writes one word, and the same words can be written"


class BrokenCoupler(NamedTuple):
    """A coupler that breaks one clause. ``unseen``: why nobody can tell from outside, if so."""

    name: str
    clause: str
    rules: Rules
    unseen: str = ""


def broken(clause: str, title: str, unseen: str = "", /, **changed: Any) -> BrokenCoupler:
    """The page's coupler with these rules changed."""
    return BrokenCoupler(title, clause, SOUND._replace(**changed), unseen)


def without(rule: str, clause: str, say: str) -> Iterator[BrokenCoupler]:
    """One for each member of a rule that is a set, which lacks it."""
    whole = getattr(SOUND, rule)
    for each in sorted(whole, key=str):
        yield broken(clause, f"{say} {each}", **{rule: whole - {each}})


def along_with(rule: str, clause: str, say: str, more: Iterable[Any]) -> Iterator[BrokenCoupler]:
    """One for each of ``more``, which a rule that is a set has besides."""
    for each in more:
        yield broken(clause, f"{say} {each}", **{rule: getattr(SOUND, rule) | {each}})


def chosen(rule: str, clause: str, say: str, others: Iterable[Any]) -> Iterator[BrokenCoupler]:
    """One for each other value of a rule."""
    for each in others:
        yield broken(clause, f"{say} {each}", **{rule: each})


def changed_entry(rule: str, key: Any, value: Any) -> dict[str, Any]:
    """A rule that is a mapping, with one entry changed."""
    return {rule: {**getattr(SOUND, rule), key: value}}


def frames() -> Iterator[BrokenCoupler]:
    """Clause 1."""
    yield from chosen("connections", "1.1", "most connections", (1, 2, 3))
    for function in (*SOUND.functions, 0x83, 0x90, 0x97, 0x87):
        yield broken("1.2", f"unit 1 in answers {function:#x}",
                     header=lambda t, u, pdu, f=function: (t, 1 if pdu[0] == f else u))  # fmt: skip
        yield broken("1.2", f"transaction mod 256 in answers {function:#x}",
                     header=lambda t, u, pdu, f=function: (t & 0xFF if pdu[0] == f else t, u))  # fmt: skip
    yield broken("1.2", "transaction 0 answered as 1", header=lambda t, u, pdu: (t or 1, u))
    yield broken("1.3", "answers a request before it is whole", waits_for_the_whole=False)
    yield broken("1.3", "answers in reverse", in_order=False)
    yield from chosen("answers_of_a_piece", "1.3", "most answers of a piece", (1, 2, 10))
    yield from chosen("least_length", "1.4", "least length", (0, 1, 3))
    yield from chosen("most_length", "1.4", "most length", (253, 255, 260, 0xFFFF))
    for bit in range(16):
        yield broken("1.4", f"protocol bit {bit} ignored", protocol_bits=0xFFFF & ~(1 << bit))
    yield broken("1.4", "answers what is lost", answers_what_is_lost=True)
    yield broken("1.4", "keeps a connection that lost its place", closes_what_is_lost=False)
    yield broken("1.3", "drops what came before the lost place", answers_before_it=False)
    yield from along_with("one_ends_all", "1.4", "all end with a", ("hang-up", "lost frame"))


def requests() -> Iterator[BrokenCoupler]:
    """Clauses 2.1 to 2.4."""
    yield from without("functions", "2.1", "does not serve")
    others = (0, 7, 9, 10, 11, 12, 13, 14, 17, 20, 22, 24, 43, 65, 100, 127, 128, 131, 144, 255)
    yield from along_with("functions", "2.1", "serves", others)
    yield broken("2.1", "refuses under 0x80", refusal=lambda f, code: bytes([0x80, code]))
    yield broken("2.1", "refuses without the bit", refusal=lambda f, code: bytes([f, code]))
    for wrong in (1, 2, 3, 4, 6):
        yield broken("2.2", f"exception {wrong} told as {wrong + 1}",
                     refusal=lambda f, c, wrong=wrong: bytes([f | 0x80, c + (c == wrong)]))  # fmt: skip
    yield from orders()
    for function, most in SOUND.most_read.items():
        for step in (-1, 1):
            rule = changed_entry("most_read", function, most + step)
            yield broken("2.3", f"{function} reads at most {most + step}", **rule)
    for function, most in SOUND.most_written.items():
        for step in (-1, 1):
            unseen = TOO_LONG if step == 1 and function in (16, 23) else ""
            rule = changed_entry("most_written", function, most + step)
            yield broken("2.3", f"{function} writes at most {most + step}", unseen, **rule)
    for function in (*SOUND.most_read, 15, 16):
        for least in (0, 2):
            yield broken("2.3", f"{function} takes at least {least}", least={function: least})
    for function in (*READING, *WRITING):
        for what in ("short", "long"):
            unseen = ZERO_COUNT if what == "short" and function in (3, 4) else ""
            rule = frozenset({(what, function)})
            yield broken("2.4", f"{function} may be too {what}", unseen, no_check=rule)
    for function in (15, 16, 23):
        yield broken("2.4", f"{function} with any byte count", no_check=frozenset({("count", function)}))


def orders() -> Iterator[BrokenCoupler]:
    """Clause 2.2: adjacent checks swapped, for all and for each function code; each check first."""
    order = SOUND.order
    for at, (a, b) in enumerate(itertools.pairwise(order)):
        swapped = (*order[:at], b, a, *order[at + 2 :])
        unseen = {("function", "length"): NO_LENGTH, ("watchdog", "owner"): NO_OWNER}.get((a, b), "")
        yield broken("2.2", f"{b} before {a}", unseen, order=swapped)
        writes_only = b in ("owner", "value")
        words_only = (6, 16, 23)
        functions = words_only if b == "value" else WRITING if writes_only else (*READING, *WRITING)
        for function in functions:
            if a != "function":
                yield broken("2.2", f"{b} before {a} with {function}", unseen, order_of={function: swapped})
    for check in order[2:]:
        rest = tuple(each for each in order if each not in (check, "function"))
        yield broken("2.2", f"{check} right after function", order=("function", check, *rest))
    yield broken("2.2", "watchdog before all", order=("watchdog", *(c for c in order if c != "watchdog")))


def _bent_answer(function: int, bend: Callable[[bytes], bytes], pdu: bytes) -> bytes:
    return bend(pdu[:5]) if pdu[0] == function else pdu[:5]


def answers() -> Iterator[BrokenCoupler]:
    """Clauses 2.5 to 2.9."""
    for word in (0x0001, 0x00FF, 0x0100, 0x1234, 0x8000, 0xFE00, 0xFF01, 0xFFFF):
        yield broken("2.5", f"{word:#06x} switches on", coil_words={**SOUND.coil_words, word: True})
    for word in SOUND.coil_words:
        left = {w: bit for w, bit in SOUND.coil_words.items() if w != word}
        yield broken("2.5", f"does not take {word:#06x}", coil_words=left)
    yield broken("2.5", "on and off swapped", coil_words={0xFF00: False, 0x0000: True})
    subs = SOUND.sub_functions
    for sub, what in subs.items():
        left = {s: w for s, w in subs.items() if s != sub}
        yield broken("2.6", f"no sub-function {sub}", sub_functions=left)
        for other in {"echo", "status", "requests", "frames", "exceptions", "clear"} - {what}:
            yield broken(
                "2.6", f"sub-function {sub} is {other}", **changed_entry("sub_functions", sub, other)
            )
    for sub in (1, 3, 4, 9, 15, 18, 20, 99, 0x0100, 0x0A00):
        yield broken("2.6", f"sub-function {sub} served", **changed_entry("sub_functions", sub, "requests"))
    yield from without("zero_data", "2.6", "any data for sub-function")
    yield from without("cleared", "2.6", "clearing leaves the")
    yield from without("counted", "2.6", "does not count")
    for what in ("short", "odd"):
        yield broken("2.6", f"sub-function 0 with too {what} data", no_check=frozenset({(what, 8)}))
    yield broken("2.6", "data judged before the sub-function", data_before_sub_function=True)
    yield broken("2.6", "echoes zeros", echoes=lambda pdu: pdu[:3] + bytes(len(pdu) - 3))
    yield broken("2.6", "echoes one word", echoes=lambda pdu: pdu[:5])
    for function in (5, 6, 15, 16):
        for say, wrong in (
            ("low byte apart", lambda pdu: pdu[:4] + bytes([pdu[4] ^ 1])),
            ("address apart", lambda pdu: pdu[:2] + bytes([pdu[2] ^ 1]) + pdu[3:5]),
            ("too short", lambda pdu: pdu[:4]),
            ("too long", lambda pdu: pdu[:5] + b"\0"),
        ):
            answer = partial(_bent_answer, function, wrong)
            yield broken("2.7", f"answer of {function} {say}", short_answer=answer)
    yield broken("2.7", "bits beyond the quantity are written", bits_beyond=True)
    yield broken("2.7", "coils from the other end of the byte", coil_place=lambda at: at ^ 7)
    yield broken("2.7", "coils of the other byte", coil_place=lambda at: at ^ 8)
    yield broken("2.7", "coil 8 from the first byte", coil_from=lambda at: 0 if at == 8 else at)
    yield broken("2.7", "coils above 7 are not written", coil_place=lambda at: at if at < 8 else 99)
    yield broken("2.7", "a coil clears the others", coil_clears_others=True)
    yield broken("2.8", "reads before it writes", writes_first=False)
    for function, code in itertools.product(WRITING, (2, 3, 4, 6)):
        unseen = NOTHING_THERE if code == 2 and function in (5, 6) else ""
        rule = frozenset({(function, code)})
        yield broken(
            "2.9", f"{function} writes although refused with {code}", unseen, refused_but_written=rule
        )
    for spools in ((0x0802, 0), (0x0802, 5), (0x0803, 5), (0x0801, 7), (0x0802, 7)):
        yield broken("2.9", f"-32768 is refused in {spools[1]} words from {spools[0]:#06x} on", spools=spools)
    yield broken("2.9", "-32768 is taken in a torn image", spools_of_torn_images=False)
    yield broken("2.9", "a torn image is not kept", torn_is_kept=False)
    yield broken("2.9", "a torn image acts", torn_acts=True)


def bent_spans(spans: Spans, at: int) -> Iterator[tuple[str, Spans]]:
    """``spans`` without the one at ``at``, and with its ends moved by one."""
    begin, size = spans[at]
    others = spans[:at] + spans[at + 1 :]
    yield f"lacks {begin:#06x}", others
    bent = [(begin, size - 1), (begin + 1, size - 1), (begin, size + 1)]
    bent += [(begin - 1, size + 1)] if begin else []
    for each in bent:
        if each[1]:
            yield f"{size} at {begin:#06x} as {each[1]} at {each[0]:#06x}", (*others, each)


def _addresses(spans: Spans) -> set[int]:
    return {begin + at for begin, size in spans for at in range(size)}


def addresses() -> Iterator[BrokenCoupler]:
    """Clauses 3.1 and 3.4 to 3.6: each block with each function code, gone or an end off by one."""
    for rule, verb in (("reads", "read"), ("writes", "written")):
        table = getattr(SOUND, rule)
        for function, spans in table.items():
            for at in range(len(spans)):
                for say, bent in bent_spans(spans, at):
                    clause = "3.1" if say.startswith("lacks") else "3.4" if spans[at][0] < 0x1000 else "3.5"
                    name = f"{verb} with {function}: {say}"
                    same = function == 6 and _addresses(bent) == _addresses(spans)
                    yield broken(
                        clause, name, ONE_WORD if same else "", **changed_entry(rule, function, bent)
                    )
    for function in (6, 16, 23):
        spans = SOUND.writes[function]
        for more in (INPUTS, (0x1000, 7), (0x100C, 1), (0x1010, 4), (0x1020, 1)):
            yield broken("3.6", f"{function} writes {more[1]} at {more[0]:#06x}",
                         **changed_entry("writes", function, (*spans, more)))  # fmt: skip
    for register in (TIME, RESET, TRIGGER):
        more = (*SOUND.writes[23], (register, 1))
        yield broken("3.6", f"23 writes {register:#06x}", **changed_entry("writes", 23, more))
    for more in ((TIME, 2), (RESET, 2), (TIME, 3)):
        spans = (*SOUND.writes[16], more)
        yield broken("3.6", f"16 writes {more[1]} at {more[0]:#06x}", **changed_entry("writes", 16, spans))
    outputs = changed_entry("reads", 4, (*SOUND.reads[4], OUTPUTS))
    yield broken("3.1", "4 reads outputs", **outputs)
    spans = ((0, 0x10000),)
    for function in (3, 4, 23):
        yield broken("3.5", f"{function} reads gaps", **changed_entry("reads", function, spans))


def registers() -> Iterator[BrokenCoupler]:
    """Clauses 3.2 to 3.7: what stands in the registers."""
    yield broken("3.2", "another identification each time", name=lambda n: b"COUPLER %06d" % n)
    yield broken("3.2", "no identification", name=lambda n: bytes(14))
    yield broken("3.2", "a zero within the identification", name=lambda n: b"PAGE\0COUPLER\0\0")
    yield broken("3.2", "letters that are none", name=lambda n: b"PAGE\x07\xe4OUPLER\0\0")
    yield broken("3.2", "first letter in the high byte", HIDDEN_NAME, name=lambda n: b"APEGC UOLPRE\0\0")
    yield from chosen("status", "3.3", "status", (0x0001, 0x0002, 0x8000))
    yield from chosen("status_expired", "3.3", "status after expiry", (0x0000, 0x8001, 0x8002, 0x4000))
    for at, length in enumerate(SOUND.lengths):
        for step in (-16, -1, 1, 16):
            lengths = (*SOUND.lengths[:at], length + step, *SOUND.lengths[at + 1 :])
            yield broken("3.4", f"length {at} is {length + step}", lengths=lengths)
    for function in (1, 2):
        yield broken("3.7", f"fill bits of {function} are ones", fills_with={function: 0xFFFFFF})
    for say, wrong in (("zero", lambda word: 0), ("inverted", lambda word: word ^ 0xFFFF),
                       ("one place up", lambda word: word << 1)):  # fmt: skip
        yield broken("3.7", f"digital inputs are {say}", digital_inputs=wrong)


def owners() -> Iterator[BrokenCoupler]:
    """Clause 4."""
    yield from without("owning", "4.1", "no owner by")
    yield from without("guarded", "4.2", "strangers write with or to")
    reads = sorted(CARRIED_OUT - IMAGE_WRITES - {"6 own", "16 own"})
    yield from along_with("closed_to_others", "4.2", "strangers are refused", reads)
    yield broken("4.2", "a refused stranger becomes the owner", refused_changes_owner=True)
    yield from without("released_by", "4.3", "not released by")
    yield from chosen("release_ms", "4.3", "released after", (0, 500, 900, 1100, 2000))
    yield broken("4.3", "reading keeps the outputs", release_counts_reads=True)


def watchdogs() -> Iterator[BrokenCoupler]:
    """Clauses 5.1 to 5.3."""
    yield from chosen("time_when_active", "5.1", "set while active, answered", (0, 3))
    yield from chosen("time_when_expired", "5.1", "set while expired, answered", (0, 3))
    yield from chosen("off_up_to_ms", "5.1", "switched off by a time up to, ms,", (-1, 1, 50))
    yield from without("arming", "5.2", "not armed by")
    more = sorted((CARRIED_OUT | REFUSED) - IMAGE_WRITES)
    yield from along_with("arming", "5.2", "armed by", more)
    for trigger, kinds in SOUND.feeding.items():
        for kind in sorted(kinds):
            rule = changed_entry("feeding", trigger, kinds - {kind})
            yield broken("5.3", f"trigger {trigger}: not fed by {kind}", **rule)
        for kind in sorted((CARRIED_OUT | REFUSED) - kinds):
            rule = changed_entry("feeding", trigger, kinds | {kind})
            yield broken("5.3", f"trigger {trigger}: fed by {kind}", **rule)
    strangers = [*sorted(CARRIED_OUT - IMAGE_WRITES - {"6 own", "16 own"}), "refused 6"]
    yield from along_with("feeding_of_others", "5.3", "a stranger feeds by", strangers)
    yield from along_with("triggers", "5.3", "takes trigger", (2, 3, 0x0100, 0xFFFF))
    yield from without("triggers", "5.3", "does not take trigger")
    for say, wrong in (
        ("twice", lambda ms: 2 * ms * MS), ("half", lambda ms: ms * MS // 2),
        ("1.4 times", lambda ms: 14 * ms * MS // 10),
        ("0.9 times", lambda ms: 9 * ms * MS // 10), ("1.1 times", lambda ms: 11 * ms * MS // 10),
        ("100 ms more", lambda ms: (ms + 100) * MS), ("20 ms less", lambda ms: (ms - 20) * MS),
        ("a tenth", lambda ms: ms * MS // 10), ("the low byte", lambda ms: (ms & 0xFF) * MS),
    ):  # fmt: skip
        yield broken("5.3", f"its time is {say}", time_ns=wrong)


def expiries() -> Iterator[BrokenCoupler]:
    """Clauses 5.4 to 5.8."""
    yield from without("zeroes", "5.4", "keeps at expiry the outputs that are")
    yield broken("5.4", "the zeros of an expiry do not act", zeroes_act=False)
    yield from without("silenced", "5.4", "serves after expiry")
    yield broken("5.4", "expiry refuses the owner alone", silences="owner")
    yield broken("5.4", "own registers are refused after expiry", own_after_expiry=False)
    ends = [*sorted(CARRIED_OUT - IMAGE_WRITES - IMAGE_READS), "refused 4", "refused 1", "close"]
    yield from along_with("cleared_by", "5.4", "expiry ended by", ends)
    first, second = SOUND.reset_words
    near = [(first + step, second) for step in (-1, 1)] + [(first, second + step) for step in (-1, 1)]
    for words in (*near, (second, first)):
        yield broken("5.5", f"resets by {words[0]:#x}, {words[1]:#x}", reset_words=words)
    yield from along_with("reset_by", "5.5", "reset by", ("first", "second", "any order"))
    for rule, value in (
        ("begins_anew", False), ("spoiled_by_words", False), ("spoiled_by_requests", True),
        ("of_one_master", False), ("spoiled_by_others", False), ("forgets_the_first", False),
        ("other_word", 2), ("other_word", 0), ("reads_the_last", False),
    ):  # fmt: skip
        yield broken("5.5", f"{rule} is {value}", **{rule: value})
    yield from without("reset_clears", "5.5", "a reset leaves it")
    yield from along_with("reset_clears", "5.5", "a reset clears the", ("outputs",))
    moments = itertools.product(("expiry", "reset", "close"), ("time", "trigger"))
    yield from along_with("forgotten", "5.5", "forgotten:", moments)
    for say, wrong in (
        ("the whole time", lambda left_ns, ms: ms), ("half", lambda left_ns, ms: left_ns // MS // 2),
        ("what has passed", lambda left_ns, ms: ms - left_ns // MS),
        ("20 ms more", lambda left_ns, ms: left_ns // MS + 20),
        ("in seconds", lambda left_ns, ms: left_ns // MS // 1000),
        ("one byte", lambda left_ns, ms: left_ns // MS & 0xFF),
        ("10 ms less", lambda left_ns, ms: max(left_ns // MS - 10, 0)),
    ):  # fmt: skip
        yield broken("5.6", f"left is {say}", left_ms=wrong)
    yield from chosen("left_when_inactive", "5.6", "left while inactive", (1, 1000, 0xFFFF))
    yield from chosen("closing", "5.7", "an owner's closing", ("stops", "restarts", "expires"))
    yield from along_with("trip_is_cleared_by", "5.8", "motion watchdog cleared by", ("coupler reset",))


def images() -> Iterator[BrokenCoupler]:
    """protocol.md, clause 10."""
    yield broken("10.3", "first and last word of the inputs differ", last_word_apart=1)
    yield broken("10.4", "another layout word", OTHER_PLANT, layout=0x4C02)
    yield broken("10.4", "reserved words are ones", reserved=0xFFFF)
    yield broken("10.5", "an image of zeros does not act", takes_zeros=False)
    yield broken("10.6", "the plant's cycle stands still", cycles=False)
    yield from chosen("echo", "10.6", "the echo is", ("written", "frozen", "late"))
    yield from chosen("motion_ms", "10.7", "motion watchdog of", (0.0, 50.0, 200.0, 1e9))
    yield from along_with("trip_is_cleared_by", "10.7", "trip cleared by", ("cycle", "level"))
    yield from without("trip_is_cleared_by", "10.7", "trip not cleared by")
    yield broken(
        "10.7", "any image feeds the motion watchdog", trip_is_cleared_by=frozenset({"edge", "write"})
    )
    yield broken("10.7", "another bit tells of it", tripped_bit=0x0008)


MAKERS = (frames, requests, answers, addresses, registers, owners, watchdogs, expiries, images)
MUTANTS: tuple[BrokenCoupler, ...] = tuple(each for make in MAKERS for each in make())
