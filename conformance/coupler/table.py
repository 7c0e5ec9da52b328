"""Every case for a coupler: what is written, what must be read, and when (docs/process_image.md)."""

from collections.abc import Iterable
from functools import partial

from conformance.case import coupler
from conformance.coupler.steps import (
    LATE_MS,
    Ask,
    Fresh,
    HangUp,
    Left,
    Play,
    Send,
    Step,
    Until,
    require_this_plant,
)
from conformance.master import Master
from protocol.process_image import (
    CONTROL_RESET_WATCHDOG,
    INPUT_TABLE,
    INPUT_WORDS,
    OUTPUT_TABLE,
    OUTPUT_WORDS,
    STATUS_WATCHDOG_TRIPPED,
)

_AT = {row.name: f"{row.address:04x}" for row in INPUT_TABLE}
_RESERVED = next(row for row in INPUT_TABLE if row.reserved)
_VALVES = next(row for row in OUTPUT_TABLE if row.name == "valves")
_UNLISTED = [code for code in range(0x80) if code not in (1, 2, 3, 4, 5, 6, 8, 15, 16, 23)]

WRITES = (
    "05 0000 FF00", "06 {spare} 0001", "0F 0000 0001 01 01", "10 {spare} 0001 02 0001",
    "17 0000 0001 {spare} 0001 02 0001",
)  # fmt: skip
READS = ("01 0000 0001", "02 0000 0001", "03 0000 0001", "04 0000 0001", "03 {spare} 0001")
OWN_READS = ("03 1000 0007", "04 1000 0007", "03 100C 0001", "03 1010 0004", "03 1120 0003", "08 0000 1234")
REFUSALS = (
    ("07", "!1"), ("08 0063 0000", "!1"), ("03 0000 0000", "!3"), ("04 7000 0001", "!2"), ("06 0900 0000",
        "!2"),
    ("05 0001 1234", "!3"), ("10 {behind_outs} 0001 02 0001", "!2"), ("17 7000 0001 {spare} 0001 02 0001",
        "!2"),
    ("06 1122 0002", "!3"),
)  # fmt: skip
STATUS = "03 100C 0001"
EXPIRED, ALIVE = "0302[89a-f]...", "0302[0-7]..."
LEFT = "03 1020 0001"
FIRST, SECOND = "06 1121 BECF", "06 1121 AFFE"
RESET = (Ask(FIRST), Ask(SECOND))
WRITE, OTHER_WRITE = "06 {spare} 0001", "06 {spare} 0002"


def all_of(requests: Iterable[str], answer: str = "ok", by: str = "a") -> list[Step]:
    """Each request, answered alike."""
    return [Ask(pdu, answer, by) for pdu in requests]


def expired(time_ms: int = 100, trigger: int = 1) -> list[Step]:
    """A watchdog that a write has armed, and silence: it has expired."""
    return [Fresh(time_ms, trigger), Ask("06 {spare} FFFF"), Ask(STATUS, EXPIRED, wait_ms=time_ms + LATE_MS)]


def fed(requests: Iterable[tuple[str, str]], trigger: int, feeds: bool, by: str = "a") -> list[Step]:
    """Each request, 120 of 200 ms after a write of a: whether it begins the time anew."""
    steps: list[Step] = []
    for pdu, answer in requests:
        steps += [Fresh(200, trigger), Ask(WRITE, mark=True), Ask(pdu, answer, by, wait_ms=120, mark=feeds)]
        steps.append(Until(STATUS, EXPIRED, 200, by="c"))
    return steps


def image(cycle: int, control: int = 0, again: int | None = None) -> str:
    """The output words of this plant, valves centred; torn where ``again`` is another cycle."""
    words = [cycle, control, *[0] * (OUTPUT_WORDS - 3), cycle if again is None else again]
    return "".join(f"{word:04x}" for word in words)


def write(cycle: int, control: int = 0, again: int | None = None) -> str:
    """A request of function code 16 with ``image``."""
    return f"10 0800 {OUTPUT_WORDS:04x} {2 * OUTPUT_WORDS:02x} {image(cycle, control, again)}"


def shown(cycle: int) -> list[Step]:
    """The image of ``cycle`` is written, and the plant tells within 50 ms that it took it over."""
    return [Ask(write(cycle), mark=True), echo(cycle)]


def echo(cycle: int) -> Step:
    """The plant tells within 50 ms of the mark that it took ``cycle`` over."""
    return Until(f"03 {_AT['echo_cycle']} 0001", f"0302{cycle:04x}", None)


def trip(tripped: bool) -> str:
    """The register ``status`` of this plant: whether its motion watchdog has tripped."""
    assert STATUS_WATCHDOG_TRIPPED == 4
    return "0302 ...[4-7c-f]" if tripped else "0302 ...[0-389ab]"


PLANT_STATUS = f"03 {_AT['status']} 0001"
RUNNING: list[Step] = [
    Fresh(5000), *(Ask(write(cycle, control), wait_ms=3, mark=True) for cycle, control in
                   ((1, 0), (2, CONTROL_RESET_WATCHDOG), (3, 0))),
    Until(PLANT_STATUS, trip(False), None),
]  # fmt: skip

READING: tuple[tuple[int, str, str, list[Step]], ...] = (
    (601, "1.1", "a sound read is answered", [Ask("03 0000 0001", "0302....")]),
    (602, "1.2", "transaction and unit are repeated, in refusals too", [
        Ask(pdu, answer, transaction=number, unit=unit) for number, unit in ((0, 0), (0x1234, 17),
        (0xFFFF, 255))
        for pdu, answer in (*((pdu, "ok") for pdu in (*READS, *OWN_READS)), *REFUSALS[:5])]),
    (604, "1.3", "pieces are put together, requests of one piece are answered each, in their order", [
        Send(("0007 0000", "0006 01 03 00", "00 0001"), (7,)),
        Send(("0008 0000 0006 01 03 0000 0001 0009",), (8,)),
        Send(("0000 0006 01 03 0000 0001",), (9,)),
        Send(("".join(f"{n:04x} 0000 0006 01 03 0000 0001" for n in range(20)),), tuple(range(20))),
        Send(("0001 0000 0002 01 07 0002 0000 0006 01 08 0000 1234 0003 0000 0006 01 04 7000 0001",),
        (1, 2, 3))]),
    (607, "1.4", "a wrong protocol or length, or a master that hangs up, ends its connection and no other", [
        *(step for number, head in enumerate(
            ("0001 0006", "8000 0006", "0000 0000", "0000 0001", "0000 00FF"))
        for step in (
            Send((f"0007 0000 0006 01 03 0000 0001 0008 {head} 01 03 0000 0001",), (7,), True, f"b{number}"),
            Ask("03 0000 0001"))), *(step for size in (4, 14, 18, 22) for step in (
            Send(("000700000006010300000001"[:size],), by="b"), HangUp("b"), Ask("03 0000 0001")))]),
    (610, "2.1", "function codes that are not listed: 1 under their own number", [
        Ask(f"{code:02x} 0000 0001", "!1") for code in _UNLISTED]),
    (612, "2.3", "quantities of 0 and above the largest: 3, the largest itself: not", [
        *all_of((f"{code} 0000 {count}" for code in ("03", "04") for count in ("0000", "007E", "FFFF")),
        "!3"),
        *all_of((f"{code} 0000 {count}" for code in ("01", "02") for count in ("0000", "07D1", "FFFF")),
        "!3"),
        *all_of(("10 0800 0000 00", "10 0800 007C F8" + 246 * "00", "0F 0000 0000 00",
                 "0F 0000 07B1 F7" + 247 * "00", "17 0000 0000 0800 0001 02 0000",
                 "17 0000 007E 0800 0001 02 0000",
                 "17 0000 0001 0800 0000 00", "17 0000 0001 0800 007A F4" + 242 * "00"), "!3"),
        *all_of(("03 7000 007D", "04 7000 007D", "01 7000 07D0", "02 7000 07D0",
        "10 7000 007B F6" + 246 * "00",
                 "0F 7000 07B0 F6" + 246 * "00", "17 7000 007D 7000 0079 F2" + 242 * "00"), "!2")]),
    (617, "2.4", "a request that is not as long as it says: 3", all_of((
        "01", "02 00", "03 0000", "04 0000 00", "05 0000", "06 0800 00", "0F 0000", "10 0800 00", "17 00",
        "01 0000 0001 00", "02 0000 0001 00", "03 0000 0001 00", "04 0000 0001 0000", "05 0000 0000 00",
        "06 0800 0000 00", "10 0800 0002 02 0000", "10 0800 0001 04 0000 0000", "10 0800 0001 03 0000 00",
        "10 0800 0001 02 00", "10 0800 0001 02 0000 00", "0F 0000 0008 02 00 00", "0F 0000 0009 01 00",
        "0F 0000 0001 01", "17 0000 0001 0800 0002 02 0000", "17 0000 0001 0800 0001 04 0000 0000",
        "17 0000 0001 0800 0001 02 00"), "!3")),
    (619, "2.5", "a coil takes FF00 and 0000, any other word: 3", all_of((
        "05 0000 0001", "05 0000 00FF", "05 0000 0100", "05 0000 1234", "05 0000 FF01", "05 0000 FFFF"),
        "!3")),
    (620, "2.2", "function code before length before address", [
        *all_of(("63", "08 0063"), "!1"),
        *all_of(("03 7000 0000", "04 7000 007E", "10 7000 0001 03 0000 00", "05 7000 1234"), "!3")]),
    (622, "2.6", "diagnostics: the echo, the status, the counters, what is unknown or wrong", [
        *all_of(("08 0000 A537", "08 0000 0000", "08 0000 FFFF 1234 5678", "08 000A 0000"), "="),
        Ask("08 000D 0000", "08 000D 0000"), Ask("03 0000 0000", "!3"), Ask("08 000D 0000", "08 000D 0001"),
        Ask("08 000B 0000", "08 000B 0004"), Ask("08 000E 0000", "08 000E 0005"),
        Send(("0007 0001 0006 01",), closed=True, by="b"), Ask("08 000C 0000", "08 000C 0001"),
        Ask("08 0002 0000", "08 0002 ...."), Ask("08 000A 0000", "="), Ask("08 000C 0000", "08 000C 0000"),
        *all_of(("08 0001 0000", "08 0063 0000", "08 FFFF 0000"), "!1"),
        *all_of(("08 0000", "08 0000 12", "08 000B 0001", "08 000A 0000 00"), "!3")]),
    (631, "3.2", "the identification is text that stays the same", [
        Ask("03 1000 0007", "030e(?!0000)(00|[2-7].)+", keep="text"), Ask("03 1000 0007",
        "030e{text}", by="b"),
        Ask("04 1000 0007", "040e{text}")]),
    (632, "3.3", "the status tells of no terminal bus or configuration error", [
        Ask(STATUS, "0302 ...[048c]"), Ask("04 100C 0001", "0402 ...[048c]")]),
    (634, "3.4", "images are read whole; one word or bit more, and what lies behind: 2", [
        Ask("03 0000 {ins}"), Ask("04 0000 {ins}"), Ask("03 0800 {outs}"), Ask("01 0000 {coils}"),
        *all_of(("03 0000 {ins_and_one}", "04 0000 {ins_and_one}", "03 {behind_ins} 0001",
        "03 0800 {outs_and_one}",
                 "03 {behind_outs} 0001", "03 07FF 0002", "01 {coils} 0001", "01 FFFF 0001",
                 "05 {coils} 0000",
                 "0F {coils} 0001 01 00", "06 {behind_outs} 0000", "10 {last_out} 0002 04 00000000",
                 "17 0000 0001 {behind_outs} 0001 02 0000"), "!2")]),
    (636, "3.1", "function code 4 reads no outputs: 2", all_of(("04 0800 0001", "04 {spare} 0001"), "!2")),
    (638, "3.5", "outside the blocks, and from one block into a gap: 2", all_of((
        f"{code} {place}" for code in ("03", "04") for place in (
            "0700 0001", "0900 0001", "0FFF 0001", "0FFF 0002", "1000 0008", "1007 0001", "100B 0002",
            "100C 0002",
            "100F 0002", "1014 0001", "101F 0002", "1020 0002", "1123 0001", "111F 0002", "1120 0004",
            "FFFF 0002")),
        "!2")),
    (640, "3.6", "what is not writable, several own registers at once, own registers with 23: 2", all_of((
        pdu for at in ("0000", _AT["status"], "1000", "1006", "100C", "1010", "1013", "1020") for pdu in (
            f"06 {at} 0000", f"10 {at} 0001 02 0000", f"17 0000 0001 {at} 0001 02 0000")), "!2")
        + all_of(("10 1120 0002 04 00000000", "10 1121 0002 04 00000000", "17 0000 0001 1120 0001 02 03E8",
                  "17 0000 0001 1122 0001 02 0001", "06 111F 0000", "06 1123 0000"), "!2")),
    (642, "3.7", "digital inputs lie behind the analog ones, filled up with zeros", [
        Ask("02 0000 0008", "0201..", keep="bits"), Ask("03 {digital_in} 0001", "0302..{bits}"),
        Ask("02 0000 0001", "02010[01]"), Ask("02 0000 0003", "02010[0-7]"), Ask("01 0000 0001",
        "01010[01]")]),
)  # fmt: skip

WRITING: tuple[tuple[int, str, str, list[Step]], ...] = (
    (651, "2.7", "words are written with 6 and 16, and read back", [
        Fresh(), Ask("06 {spare} A55A", "="), Ask("03 {spare} 0001", "0302A55A"),
        Ask("10 {spare} 0001 02 1234", "=5"), Ask("03 {spare} 0001", "03021234"), Ask("01 0000 0010",
        "01023412")]),
    (653, "2.7", "coils are switched alone, over the border of two bytes, none beyond the quantity", [
        Fresh(), Ask("06 {spare} AAAA"), Ask("05 0002 FF00", "="), Ask("05 0003 0000", "="),
        Ask("03 {spare} 0001", "0302AAA6"), Ask("06 {spare} 0000"), Ask("05 000F FF00", "="),
        Ask("0F 0006 0005 01 F5", "=5"), Ask("03 {spare} 0001", "03028540"), Ask("0F 0000 0009 02 00FF",
        "=5"),
        Ask("03 {spare} 0001", "03028500"), Ask("06 {spare} FFFF"), Ask("01 0000 0003", "010107")]),
    (655, "2.8", "an exchange writes before it reads", [
        Fresh(), Ask("17 {spare} 0001 {spare} 0001 02 5AA5", "17025AA5"),
        Ask("17 {spare} 0001 {spare} 0001 02 0FF0", "17020FF0"),
        Ask("17 0000 0002 0800 0002 04 3FFF7FFF", "1704........"), Ask("03 0800 0002", "03043FFF7FFF"),
        Ask("17 1000 0007 {spare} 0001 02 0001", "170e.*")]),
    (657, "2.9", "a refused write changes nothing, not in part either", [
        Fresh(777), Ask("06 {spare} 1111"), *RESET, *(step for pdu, answer in (
            ("06 {spare} 2222 00", "!3"), ("10 {spare} 0002 04 22222222", "!2"),
                ("10 {spare} 0001 03 2222", "!3"),
            ("17 0700 0001 {spare} 0001 02 2222", "!2"), ("17 0000 0000 {spare} 0001 02 2222", "!3"),
            ("17 0000 0001 {spare} 0002 04 22222222", "!2"), ("05 0001 1234", "!3"),
                ("0F 0008 0009 02 FFFF", "!2"),
            ("06 1122 0002", "!3"), ("06 1120 0005 00", "!3"), ("10 1120 0002 04 00050005", "!2"),
            ("06 1121 1234", "!3")) for step in (
            Ask(pdu, answer), Ask("03 {spare} 0001", "03021111"), Ask("03 1120 0003", "03060309AFFE0001")))]),
    (661, "4.2", "another master reads everything, and writes neither outputs nor the watchdog: 6", [
        Fresh(), Ask("06 {spare} 8000"), *all_of(WRITES, "!6", "b"),
        *all_of(("06 1120 0005", "06 1122 0000", FIRST, SECOND, "10 1122 0001 02 0000",
        "10 1121 0001 02 BECF"),
                "!6", "b"), *all_of((*READS, *OWN_READS), by="b"),
        Ask("03 {spare} 0001", "03028000", "b"), Ask("03 1122 0001", "03020001", "b"), Ask(WRITE),
        HangUp("b"), Ask(OTHER_WRITE, "!6", "c", wait_ms=20), Ask(WRITE)]),
    (664, "4.3", "once the owner has hung up or reset the watchdog, another master may write", [
        Fresh(), Ask(WRITE, by="b"), Ask(OTHER_WRITE, "!6"), HangUp("b"), Ask(OTHER_WRITE, wait_ms=20),
        *RESET, Ask(WRITE), Ask(OTHER_WRITE, "!6", "c"), *RESET, Ask(OTHER_WRITE, by="c"), Ask(WRITE, "!6")]),
    (861, "4.1", "each writing function code makes its connection the owner of all outputs", [
        Fresh(), *(step for pdu in (*WRITES, "06 0800 0000") for step in (
            Ask(pdu), *all_of((*WRITES, "06 0800 0000", "10 0802 0001 02 0000"), "!6", "b"), *RESET))]),
    (865, "2.2", "length and address before the owner, the owner before a value", [
        Fresh(), Ask(WRITE), Ask("07", "!1", "b"), *all_of(("06 0900 0000", "10 7000 0001 02 0000"), "!2",
        "b"),
        *all_of(("06 {spare} 0000 00", "10 {spare} 0001 03 0000"), "!3", "b"),
        *all_of(("06 1122 0002", "06 1121 1234"), "!6", "b")]),
    (868, "4.3", "an owner that writes no more is followed after 1000 ms, also when it reads on", [
        step for time_ms in (0, 5000) for step in (
            Fresh(time_ms), Ask(WRITE), Ask(WRITE, wait_ms=700, mark=True), Ask(OTHER_WRITE, "!6",
            "b", wait_ms=400),
            Ask("03 0000 0001", wait_ms=300), Until(OTHER_WRITE, "=", 1000), Ask(WRITE, "!6"),
            Ask(FIRST, by="b"), Ask(SECOND, by="b"))]),
    (671, "5.1", "the watchdog's time is set while it is inactive, else 4; a time of 0 is none", [
        Fresh(), *(step for word in ("0064", "FFFF", "0000", "01F4") for step in (
            Ask(f"06 1120 {word}", "="), Ask("03 1120 0001", f"0302{word}"))),
        Ask("10 1120 0001 02 03E8"), Ask(WRITE), Ask("06 1120 0000", "!4"), Ask("03 1120 0001", "030203E8"),
        Fresh(0), Ask(WRITE), Ask(LEFT, "03020000"), Ask(STATUS, ALIVE, wait_ms=1200), Ask("06 1120 0064")]),
    (673, "5.2", "reading, refused requests and own registers do not arm it", [
        Fresh(100), *(step for pdu, answer in (
            *((pdu, "ok") for pdu in (*READS, *OWN_READS, "06 1122 0000", "10 1122 0001 02 0001")), *REFUSALS)
            for step in (Ask(pdu, answer), Ask(LEFT, "03020000"))), Ask(STATUS, ALIVE, wait_ms=150)]),
    (675, "5.2", "each writing function code arms it, to its full time", [
        step for pdu in (*WRITES, "06 0800 0000") for step in (
            Fresh(100, 0), Ask(pdu, mark=True), Until(STATUS, EXPIRED, 100))]),
    (871, "5.3", "it expires when its time has passed since the last write, neither before nor after", [
        step for time_ms in (100, 200, 1000) for step in (
            Fresh(time_ms, 0), Ask(WRITE), Ask(WRITE, wait_ms=0.5 * time_ms, mark=True),
            Until(STATUS, EXPIRED, time_ms))]),
    (677, "5.3", "trigger 1: whatever of the owner is carried out retriggers it, what is refused does not", [
        *fed(((pdu, "ok") for pdu in (*READS, *OWN_READS, *WRITES, "06 1122 0001",
        "10 1122 0001 02 0001")), 1, True),
        *fed(REFUSALS, 1, False)]),
    (678, "5.3", "trigger 0: writes to outputs alone retrigger it; other triggers than 0 and 1: 3", [
        *fed(((pdu, "ok") for pdu in WRITES), 0, True),
        *fed(((pdu, "ok") for pdu in (*READS, *OWN_READS, "06 1122 0000")), 0, False),
        Fresh(), *all_of((f"06 1122 {word}" for word in ("0002", "0003", "0100", "8000", "FFFF")), "!3"),
        *(step for word in ("0000", "0001") for step in (
            Ask(f"06 1122 {word}", "="), Ask("03 1122 0001", f"0302{word}")))]),
    (679, "5.3", "nothing of another master retriggers it", [
        *fed(((pdu, "ok") for pdu in (*READS, *OWN_READS)), 1, False, "b"),
        *fed(((pdu, "!6") for pdu in (*WRITES, "06 1122 0001")), 1, False, "b"), *fed(REFUSALS[:3], 1,
        False, "b")]),
    (683, "5.4", "expiry latches: the image is refused to everybody with 4, own registers are served", [
        *expired(), *(step for by in ("a", "b") for step in (
            *all_of((*READS, *WRITES, "06 0800 0000"), "!4", by), *all_of(OWN_READS, by=by))),
        Ask("06 1122 0001"), Ask("06 1120 0309", "!4"), Ask(LEFT, "03020000"), Ask("08 0002 0000",
        "08 0002 [89a-f]..."),
        *all_of(("07", "08 0063 0000"), "!1"), Ask("03 0900 0001", "!2"), Ask("03 0000 0001 00", "!3"),
        Fresh(100), Ask(WRITE, by="b"), Ask(STATUS, EXPIRED, wait_ms=150), *all_of(WRITES, "!4", "b"),
        HangUp("b"),
        *all_of(("08 000A 0000", "06 1122 0001")), Ask(STATUS, EXPIRED, "c", wait_ms=500)]),
    (686, "5.4", "expiry sets every output to zero", [
        Fresh(100), Ask("10 0800 0002 04 01018000"), Ask("06 {spare} FFFF"), Ask(STATUS,
        EXPIRED, wait_ms=150), *RESET,
        Ask("03 0800 {outs}", "03..(00)+")]),
    (687, "5.5", "two words of one master reset it; time, trigger and outputs stay, the next write arms", [
        *expired(trigger=0), Ask(FIRST, "="), *all_of(OWN_READS), Ask(FIRST), Ask("07", "!1"),
        Ask(SECOND, "="), Ask(STATUS, ALIVE), Ask("03 1120 0003", "03060064AFFE0000"), Ask(LEFT, "03020000"),
        Ask("06 {spare} 1234"), *RESET, Ask("03 {spare} 0001", "03021234", wait_ms=150), Ask(STATUS, ALIVE),
        Ask(WRITE, mark=True), Until(STATUS, EXPIRED, 100), Ask("10 1121 0001 02 BECF", "=5"),
        Ask("10 1121 0001 02 AFFE", "=5"), Ask(STATUS, ALIVE)]),
    (688, "5.5", "no other words reset it: 3", [
        *expired(), Ask(SECOND, "!3"), Ask(FIRST), Ask("06 1121 0000", "!3"), Ask(SECOND, "!3"),
        Ask(FIRST), Ask(SECOND, "!3", "b"), Ask(SECOND, "!3"), Ask(FIRST), Ask(FIRST, by="b"), Ask(SECOND,
        "!3"),
        Ask(STATUS, EXPIRED),
        *(step for word in ("BECE", "BED0", "3ECF", "CFBE") for step in (
            Ask(f"06 1121 {word}", "!3"), Ask(SECOND, "!3"))),
        *(step for word in ("AFFD", "AFFF", "FEAF") for step in (
            Ask(FIRST), Ask(f"06 1121 {word}", "!3"), Ask(SECOND, "!3"))),
        Ask(STATUS, EXPIRED), Ask("03 1121 0001", "0302BECF"), *RESET, Ask(SECOND, "!3")]),
    (694, "5.6", "the time left is what is left, and 0 while it is inactive", [
        step for time_ms in (200, 3000, 60_000) for step in (
            Fresh(time_ms, 0), Ask(LEFT, "03020000"), Ask(WRITE, mark=True), Left(LEFT, time_ms),
            Left(LEFT, time_ms, 60),
            Ask(WRITE, mark=True), Left(LEFT, time_ms, 60), *RESET, Ask(LEFT, "03020000"))]),
    (695, "5.7", "an owner that hangs up does not stop it; another master's write begins its time anew", [
        Fresh(200), Ask(WRITE, by="b", mark=True), Ask(LEFT, wait_ms=120), HangUp("b"),
        Until(STATUS, EXPIRED, 200, by="a"),
        Fresh(200), Ask(WRITE, by="b"), HangUp("b"), Ask(OTHER_WRITE, wait_ms=120, mark=True),
        Until(STATUS, EXPIRED, 200)]),
)  # fmt: skip

PLANT: tuple[tuple[int, str, str, list[Step]], ...] = (
    (911, "10.4", "the inputs' reserved words are zero; the digital inputs repeat the status", [
        Ask(PLANT_STATUS, keep="status"), Ask("03 {digital_in} 0001", "0302{status}"), *(
        Ask(f"{code} {_RESERVED.address:04x} {_RESERVED.words:04x}", f"{code}{2 * _RESERVED.words:02x}0+")
        for code in ("03", "04"))]),
    (912, "10.6", "the plant's cycle advances while nobody writes, as of the moment of each request", [
        Ask("03 0000 0001", keep="cycle"),
        Ask("04 0000 0001", "0402(?!{cycle})....", wait_ms=100, keep="cycle"),
        Ask("03 0000 0001", "0302(?!{cycle})....", wait_ms=100)]),
    (922, "10.3", "inputs that are read in one request are whole: the first word is the last", [
        Ask(f"{code} 0000 {INPUT_WORDS:04x}", rf"{code}..(....).*\1", wait_ms=7) for code in ("03",
        "04") * 5]),
)  # fmt: skip

PLANT_WRITTEN: tuple[tuple[int, str, str, list[Step]], ...] = (
    (913, "10.6", "the echo repeats the cycle of each whole image, over its wrap", [
        Fresh(), *(step for cycle in (1, 2, 0x7FFF, 0x8000, 0xFFFF, 0, 1) for step in shown(cycle)),
        Ask(f"17 0000 0001 0800 {OUTPUT_WORDS:04x} {2 * OUTPUT_WORDS:02x} {image(7)}", mark=True), echo(7)]),
    (914, "2.9", "a torn image is kept and read back, and does not act until it is whole", [
        Fresh(), *shown(1000), Ask("06 0800 03E9"), Ask("03 0800 0001", "030203E9"),
        Ask(write(1002, again=1000)), Ask("03 0800 0001", "030203EA"),
        Ask(f"03 {_AT['echo_cycle']} 0001", "030203E8", wait_ms=LATE_MS),
        Ask(f"06 {0x800 + OUTPUT_WORDS - 1:04x} 03EA", mark=True), echo(1002)]),
    (915, "2.9", "a spool command of -32768 is refused whole with 3, in a torn image too; -32767 is taken", [
        Fresh(), *(step for kept in (write(5), write(9999, again=5)) for step in (
            Ask(kept), *(step for at in range(_VALVES.address, _VALVES.address + _VALVES.words) for step in (
                Ask(f"06 {at:04x} 8000", "!3"), Ask(f"10 {at - 1:04x} 0002 04 00008000", "!3"),
                Ask(f"17 0000 0001 {at:04x} 0001 02 8000", "!3"))),
            Ask(f"03 0800 {OUTPUT_WORDS:04x}", f"03..{kept[-4 * OUTPUT_WORDS:]}"))),
        *(Ask(f"06 {at:04x} 8001", "=") for at in range(_VALVES.address, _VALVES.address + _VALVES.words))]),
    (923, "10.5", "all registers zero is a valid image, and acts", [Fresh(), *shown(77), *shown(0)]),
    (917, "5.4", "the zeros of an expiry act: the plant takes their cycle over", [
        Fresh(300), Ask(write(4242), mark=True), echo(4242), Until(STATUS, EXPIRED, 300), *RESET,
        Ask(f"03 {_AT['echo_cycle']} 0001", "03020000")]),
    (918, "10.7", "the motion watchdog trips 100 ms after the cycle's last advance, also while images come", [
        *RUNNING, Ask(write(0xFFFF)), Ask(write(0), wait_ms=60), Ask(write(1), wait_ms=60, mark=True),
        Ask(PLANT_STATUS, trip(False), wait_ms=50), Ask(write(1), wait_ms=20),
        Until(PLANT_STATUS, trip(True), 100)]),
    (920, "10.7", "it stays tripped until a rising edge of RESET_WATCHDOG", [
        *RUNNING, Ask(write(20, CONTROL_RESET_WATCHDOG)), Ask(PLANT_STATUS, trip(True), wait_ms=200),
        *(step for cycle in (21, 22, 23) for step in (
            Ask(write(cycle, CONTROL_RESET_WATCHDOG)), Ask(PLANT_STATUS, trip(True), wait_ms=20))),
        *RUNNING[1:]]),
    (921, "5.8", "a reset of the coupler's watchdog leaves the motion watchdog tripped", [
        *RUNNING, Ask(PLANT_STATUS, trip(True), wait_ms=200), *expired(), *RESET,
        Ask(PLANT_STATUS, trip(True), wait_ms=LATE_MS)]),
)  # fmt: skip


def play(steps: list[Step], plant: bool, master: Master) -> None:
    if plant:
        require_this_plant(master)
    Play(master).run(steps)


for rows, writes, of_this_plant in (
    (READING, False, False), (WRITING, True, False), (PLANT, False, True), (PLANT_WRITTEN, True, True),
):  # fmt: skip
    for number, clause, title, steps in rows:
        coupler.case(number, clause, title, motion=writes)(partial(play, steps, of_this_plant))
