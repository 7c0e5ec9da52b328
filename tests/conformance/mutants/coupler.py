"""Couplers with one thing wrong each, and the cases meant to catch them."""

from typing import Any, NamedTuple

from plant_emulator.core.coupler.modbus_requests import WRITING
from plant_emulator.core.coupler.watchdog import CouplerWatchdog
from plant_emulator.shell.coupler import Coupler
from protocol.coupler_registers import WATCHDOG_TIME_MS
from tests.conformance.couplers import ThreadedCoupler


class FramesAsPymodbusDoes(ThreadedCoupler):
    """Answers exceptions under function code 0x80, as pymodbus 3.16.1 does for a quantity of 0 or 126."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        right: bytes = answer(pdu)
        return b"\x80" + right[1:] if right[0] & 0x80 else right


class TakesAnyWordForOn(ThreadedCoupler):
    """Takes FC 5 with 0x1234 for ON."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        odd = pdu[0] == 5 and len(pdu) == 5 and pdu[3:] not in (b"\xff\0", b"\0\0")
        right: bytes = answer(pdu[:3] + b"\xff\0" if odd else pdu)
        return right


class AnswersFunction7(ThreadedCoupler):
    """Answers function code 7, which is not listed."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        right: bytes = answer(pdu)
        return b"\x07\x00" if pdu[0] == 7 else right


class ReadsBeforeItWrites(ThreadedCoupler):
    """Executes FC 23 in the wrong order."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        if pdu[0] != 23:
            return super().altered(coupler, master, unit, pdu, answer)
        before: bytes = answer(b"\x03" + pdu[1:5])
        right: bytes = answer(pdu)
        return right if right[0] & 0x80 or before[0] & 0x80 else b"\x17" + before[1:]


class IgnoresByteCounts(ThreadedCoupler):
    """Makes the byte count fit by itself."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        if pdu[0] == 16 and len(pdu) >= 6:
            size = 2 * int.from_bytes(pdu[3:5], "big")
            if 0 < size < 240:
                pdu = pdu[:5] + bytes([size]) + pdu[6:].ljust(size, b"\0")[:size]
        right: bytes = answer(pdu)
        return right


class ReadsGapsAsZero(ThreadedCoupler):
    """Answers zero where no register is."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        right: bytes = answer(pdu)
        if right == b"\x83\x02":
            size = 2 * int.from_bytes(pdu[3:5], "big")
            return bytes([3, size]) + bytes(size)
        return right


class WritesTheSoundPart(ThreadedCoupler):
    """Writes what FC 23 wants written although it refuses the read."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        right: bytes = answer(pdu)
        if right == b"\x97\x02":
            answer(b"\x10" + pdu[5:])
        return right


class SwapsTheEcho(ThreadedCoupler):
    """Answers FC 6 with the bytes of the word swapped."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        right: bytes = answer(pdu)
        return right[:3] + right[:2:-1] if right[0] == 6 and len(right) == 5 else right


class EchoesZero(ThreadedCoupler):
    """Answers diagnostics 0 with zeros."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        right: bytes = answer(pdu)
        return right[:3] + bytes(len(right) - 3) if right[0] == 8 and right[2] == 0 else right


class WithWatchdog(ThreadedCoupler):
    """Our coupler around another watchdog."""

    watchdog: type[CouplerWatchdog]

    def make(self) -> Coupler:
        coupler = super().make()
        coupler._watchdog.__class__ = self.watchdog
        return coupler


def with_watchdog(kind: type[CouplerWatchdog]) -> type[ThreadedCoupler]:
    """A coupler around a broken watchdog, named after it."""
    return type(kind.__name__, (WithWatchdog,), {"watchdog": kind, "__doc__": kind.__doc__})


class LetsAnybodyWrite(CouplerWatchdog):
    """Knows no owner."""

    def is_owned_by_another(self, master: object, now_ns: int) -> bool:
        return False


class KeepsADeadOwner(CouplerWatchdog):
    """Does not notice that a master has gone."""

    def gone(self, master: object) -> None:
        pass


class DiesWithItsOwner(CouplerWatchdog):
    """Stops the watchdog when the owner hangs up."""

    def gone(self, master: object) -> None:
        self.armed = self.armed and self._owner is not master
        super().gone(master)


class NeverExpires(CouplerWatchdog):
    """Counts to nothing."""

    def look(self, now_ns: int) -> bool:
        return False


class ExpiresTooSoon(CouplerWatchdog):
    """Counts twice as fast."""

    def expires_at_ns(self) -> int:
        return self._fed_ns + self.time_ms * 500_000


class ForgivesAWrite(CouplerWatchdog):
    """Lets the next write clear the expiry."""

    def refusal(self, master: object, writes: bool, now_ns: int) -> int:
        if writes:
            self.expired = False
        return super().refusal(master, writes, now_ns)


class ReadsOnAfterExpiry(CouplerWatchdog):
    """Refuses writes alone after expiry."""

    def refusal(self, master: object, writes: bool, now_ns: int) -> int:
        return super().refusal(master, writes, now_ns) if writes else 0


class ArmedByReading(CouplerWatchdog):
    """Lets any telegram arm it."""

    def obeyed(self, master: object, wrote: bool, now_ns: int) -> None:
        if not self.armed and self.time_ms > 0 and not self.expired:
            self.armed, self._fed_ns = True, now_ns
        super().obeyed(master, wrote, now_ns)


class FedByAnybody(CouplerWatchdog):
    """Lets any master retrigger it."""

    def obeyed(self, master: object, wrote: bool, now_ns: int) -> None:
        super().obeyed(master, wrote, now_ns)
        self._fed_ns = now_ns


class FedByReading(CouplerWatchdog):
    """Does not look at the trigger register."""

    def obeyed(self, master: object, wrote: bool, now_ns: int) -> None:
        super().obeyed(master, wrote, now_ns)
        if master is self._owner:
            self._fed_ns = now_ns


class SetWhileActive(CouplerWatchdog):
    """Lets its time be set at any moment."""

    def configure(self, master: object, address: int, word: int, now_ns: int) -> int:
        if address == WATCHDOG_TIME_MS:
            self.time_ms = word
            return 0
        return super().configure(master, address, word, now_ns)


class ResetByTheFirstWord(CouplerWatchdog):
    """Needs no second word."""

    def _reset(self, master: object, word: int) -> int:
        self.expired = self.expired and word != 0xBECF
        return super()._reset(master, word)


class ResetByTheSecondWord(CouplerWatchdog):
    """Needs no first word."""

    def _reset(self, master: object, word: int) -> int:
        self.expired = self.expired and word != 0xAFFE
        return super()._reset(master, word)


class ResetInAnyOrder(CouplerWatchdog):
    """Counts the two words, whichever comes first."""

    def _reset(self, master: object, word: int) -> int:
        seen = getattr(self, "_seen", set()) | {word}
        self._seen = seen
        code = super()._reset(master, word)
        if seen >= {0xBECF, 0xAFFE}:
            self._seen = set()
            self.expired = self.armed = False
        return code


class ResetByTwoMasters(CouplerWatchdog):
    """Does not look who gave the first word."""

    def _reset(self, master: object, word: int) -> int:
        if self._resetting is not None:
            self._resetting = master
        return super()._reset(master, word)


class ReadOnlyIsWritable(ThreadedCoupler):
    """Says that it has written what is read only."""

    def altered(self, coupler: Coupler, master: Any, unit: int, pdu: bytes, answer: Any) -> bytes:
        right: bytes = answer(pdu)
        return pdu[:5] if right[0] & 0x80 and right[1] == 2 and pdu[0] in WRITING else right


class Mutant(NamedTuple):
    """A broken coupler and the case that must catch it."""

    make: type[ThreadedCoupler]
    case: int


MUTANTS = (
    Mutant(FramesAsPymodbusDoes, 612),
    Mutant(TakesAnyWordForOn, 619),
    Mutant(AnswersFunction7, 610),
    Mutant(ReadsBeforeItWrites, 655),
    Mutant(IgnoresByteCounts, 618),
    Mutant(ReadsGapsAsZero, 638),
    Mutant(WritesTheSoundPart, 657),
    Mutant(SwapsTheEcho, 651),
    Mutant(EchoesZero, 621),
    Mutant(ReadOnlyIsWritable, 640),
    *(
        Mutant(with_watchdog(kind), case)
        for kind, case in (
            (LetsAnybodyWrite, 661),
            (KeepsADeadOwner, 664),
            (DiesWithItsOwner, 695),
            (NeverExpires, 674),
            (ExpiresTooSoon, 676),
            (ForgivesAWrite, 685),
            (ReadsOnAfterExpiry, 683),
            (ArmedByReading, 672),
            (FedByAnybody, 679),
            (FedByReading, 678),
            (SetWhileActive, 681),
            (ResetByTheFirstWord, 688),
            (ResetByTheSecondWord, 689),
            (ResetInAnyOrder, 690),
            (ResetByTwoMasters, 692),
        )
    ),
)
