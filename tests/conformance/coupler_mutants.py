# ruff: noqa: E501  (a row is read beside the line that it changes)
"""Our coupler changed in one place each. A row: what it then does, the case that must catch it, the edits."""

from typing import Any, NamedTuple

from tests.conformance.couplers import ShiftedClock, ThreadedCoupler
from tests.conformance.mutator import Edit, copies

R, W, I, A = "requests", "watchdog", "image", "answers"  # noqa: E741
F, P, S, B = "framing", "pdu", "coupler", "bench"
# In the order in which they need one another.
MODULES = {
    R: "plant_emulator.core.coupler.modbus_requests", W: "plant_emulator.core.coupler.watchdog",
    I: "plant_emulator.core.coupler.image", A: "plant_emulator.core.coupler.answers", F: "foundation.modbus",
    P: "plant_emulator.shell.modbus_pdu", S: "plant_emulator.shell.coupler",
    B: "tests.conformance.couplers",
}  # fmt: skip
TERMINALS = "        if code == 0 and terminals:\n"
WRITING = "        code, image, torn = self._image.write(span.address, request.values)"
RESETS = "            self.armed, self.expired, self._owner = False, False, None"
DATA = "        if not data:\n            self.close()"

# fmt: off
ROWS: tuple[tuple[Any, ...], ...] = (
    ("answers a word too many", 601, (P, "    words = read or request.values\n", "    words = [*read, 0] if read else request.values\n")),
    ("answers transaction 1", 602, (S, "self._coupler.answer(self, unit, pdu), unit, transaction)", "self._coupler.answer(self, unit, pdu), unit, 1)")),
    ("answers unit 1", 602, (S, "self._coupler.answer(self, unit, pdu), unit, transaction)", "self._coupler.answer(self, unit, pdu), 1, transaction)")),
    ("answers pieces in reverse", 604, (S, 'else b"".join(answers))', 'else b"".join(answers[::-1]))')),
    ("drops what comes behind a request", 604, (S, "self._held = self._held[used:]", 'self._held = b""')),
    ("forgets half a request", 604, (S, "        self._held += data", "        self._held = data")),
    ("takes any length", 607, (F, "not 2 <= length <= MAX_PDU_BYTES + 1:", "not 2 <= length:")),
    ("keeps a connection that lost its place", 607, (S, '            self._send(b"".join(answers))\n            self.close()', '            self._send(b"".join(answers))\n            self._held = b""')),
    ("drops what came before the lost place", 607, (S, '            self._send(b"".join(answers))\n            self.close()', "            self.close()")),
    ("a master that hangs up ends all others", 607, (S, DATA, "        if not data:\n            [each.close() for each in tuple(self._coupler._connections)]")),
    ("serves function code 7", 610, (P, "modbus.DIAGNOSTICS}", "modbus.DIAGNOSTICS, 7}")),
    ("does not serve 4", 602, (P, "*COUPLER_MAP.reads,", "*({*COUPLER_MAP.reads} - {4}),")),
    ("reads 0 and any number of registers", 612, (P, "    elif decoded_pdu is not None and function in COUPLER_MAP.reads:\n", "    elif function in (3, 4) and len(data) == 5:\n        return Request(function, 0, Span(int.from_bytes(data[1:3]), int.from_bytes(data[3:5])))\n    elif decoded_pdu is not None and function in COUPLER_MAP.reads:\n")),
    ("writes 2000 coils", 612, (P, "MAX_WRITE_BITS = 1968", "MAX_WRITE_BITS = 2000")),
    ("takes trailing bytes", 617, (F, "!= len(framed) + 2 and", "> len(framed) + 2 and")),
    ("takes any byte count of 23", 617, (P, "decoded_pdu.write_byte_count == 2 * decoded_pdu.write_count <=", "2 * decoded_pdu.write_count <=")),
    ("any word switches a coil", 619, (P, "    decoded_pdu = decoded(_DECODER, data)\n", "    if function == 5 and len(data) == 5 and data[3:] != bytes(2):\n        data = data[:3] + b'\\xff\\0'\n    decoded_pdu = decoded(_DECODER, data)\n")),
    ("the address before the length", 620, (P, "    return Request(function, modbus.ILLEGAL_VALUE)", "    return Request(function, 2 if data[1:2] == b'\\x70' else modbus.ILLEGAL_VALUE)")),
    ("does not count exceptions", 622, (A, "            self.statistics.exceptions += 1", "            pass")),
    ("does not count lost frames", 622, (S, 'self._tell("framing_errors", ', 'self._tell("quiet", ')),
    ("clears no counters", 622, (A, "            if sub_function == CLEAR_COUNTERS:", "            if False:")),
    ("any data for a sub-function", 622, (P, "    return (0,) if data == 0 else ()", "    return (0,)"), (P, "if encoded(decoded_pdu) == data and", "if")),
    ("another identification each time", 631, (I, "return identification_words()[address - IDENTIFICATION]", "return 0x4141 + (now_ns >> 4 & 0xF)")),
    ("status bit 0", 632, (I, "return STATUS_FIELDBUS if self._watchdog.expired else 0", "return 1")),
    ("one input word more", 634, (I, "_INPUTS = Span(INPUT_ADDRESS, INPUT_IMAGE_WORDS)", "_INPUTS = Span(INPUT_ADDRESS, INPUT_IMAGE_WORDS + 1)")),
    ("one output word less", 634, (I, "_OUTPUTS = Span(OUTPUT_ADDRESS, OUTPUT_IMAGE_WORDS)", "_OUTPUTS = Span(OUTPUT_ADDRESS, OUTPUT_IMAGE_WORDS - 1)")),
    ("one coil more", 634, (I, "Span(0, DIGITAL_OUTPUTS)", "Span(0, DIGITAL_OUTPUTS + 1)")),
    ("4 reads outputs", 636, (I, "READ_INPUT: (_INPUTS, *", "READ_INPUT: (_INPUTS, _OUTPUTS, *")),
    ("gaps are read", 638, (R, "    return ILLEGAL_ADDRESS", "    return 0 if 0x1007 <= span.address < 0x100C else ILLEGAL_ADDRESS"), (I, "return identification_words()[", "return (*identification_words(), *[0] * 9)[")),
    ("6 writes inputs", 640, (I, "WRITE_SINGLE: (_OUTPUTS, *", "WRITE_SINGLE: (_OUTPUTS, Span(0, 2), *")),
    ("23 writes own registers", 640, (I, "READ_WRITE_MULTIPLE: (_OUTPUTS,),", "READ_WRITE_MULTIPLE: (_OUTPUTS, *_WRITABLE_ROWS),")),
    ("digital inputs are zero", 642, (I, "self._sensor_words()[_STATUS_WORD] if", "0 if")),
    ("6 answers another word", 651, (P, "    words = read or request.values\n", "    words = read or request.values\n    words = [words[0] ^ 1] if request.function == 6 else words\n")),
    ("16 does not write", 651, (A, WRITING, "        if request.function == 16:\n            return 0\n" + WRITING)),
    ("a coil clears the others", 653, (I, "        word = self._outputs[-1]\n        for at, bit", "        word = 0\n        for at, bit")),
    ("coils of the other byte", 653, (I, "word | 1 << at if bit else word & ~(1 << at)", "word | 1 << (at ^ 8) if bit else word & ~(1 << (at ^ 8))")),
    ("reads before it writes", 655, (A, "        if code == 0 and writes is not None:\n", "        before = self._read_words(request, now_ns) if code == 0 else ()\n        if code == 0 and writes is not None:\n"), (A, "        read = self._read_words(request, now_ns)", "        read = before")),
    ("an exchange that is refused has written", 657, (A, TERMINALS, "        if code == 2 and request.function == 23 and writes.words == 1:\n            self._image.write(writes.address, request.values)\n" + TERMINALS)),
    ("23 of a stranger", 661, (A, "code = self._watchdog.refusal(master, wrote, now_ns)", "code = self._watchdog.refusal(master, wrote and request.function != 23, now_ns)")),
    ("a stranger sets the trigger", 661, (W, "        if self.is_owned_by_another(master, now_ns):\n            return OWNED_BY_ANOTHER\n        if address", "        if address")),
    ("strangers do not read", 661, (W, "OWNED_BY_ANOTHER if writes and", "OWNED_BY_ANOTHER if")),
    ("a stranger's hang-up releases", 661, (W, "        if self._owner is master:\n            self._owner = None\n        if self._resetting", "        self._owner = None\n        if self._resetting")),
    ("closing does not release", 664, (W, "        if self._owner is master:\n            self._owner = None\n        if self._resetting", "        if self._resetting")),
    ("a reset does not release", 664, (W, RESETS, "            self.armed, self.expired = False, False")),
    ("5 makes no owner", 861, (A, "        if wrote:\n            self.writer = master", "        if wrote and request.function == 5:\n            self._watchdog._owner = None\n        if wrote:\n            self.writer = master")),
    ("the owner before the length", 865, (A, TERMINALS, "        if code == 3 and self._watchdog.is_owned_by_another(master, now_ns):\n            code = 6\n" + TERMINALS)),
    ("a value before the owner", 865, (W, "        if self.is_owned_by_another(master, now_ns):\n            return OWNED_BY_ANOTHER\n        if address", "        if address == 0x1122 and word > 1:\n            return 3\n        if self.is_owned_by_another(master, now_ns):\n            return OWNED_BY_ANOTHER\n        if address")),
    ("silence does not release", 868, (W, "return now_ns - self._written_ns < self._release_ns", "return True")),
    ("silence releases after 900 ms", 868, (W, "< self._release_ns\n", "< 0.9 * self._release_ns\n")),
    ("reading keeps the outputs", 868, (W, "            self._fed_ns = now_ns\n", "            self._fed_ns = self._written_ns = now_ns\n")),
    ("an active watchdog is set", 671, (W, "            if self.armed or self.expired:\n                return WATCHDOG_EXPIRED\n", "")),
    ("a time of 0 is 1 s", 671, (W, "self.armed = self.time_ms > 0", "self.armed = True"), (W, "self._fed_ns + self.time_ms * MS", "self._fed_ns + (self.time_ms or 1000) * MS")),
    ("reading arms", 673, (W, "        if wrote:\n            self._owner, ", "        if not wrote and self._owner is None:\n            self.armed, self._fed_ns = self.time_ms > 0, now_ns\n        if wrote:\n            self._owner, ")),
    ("15 does not arm", 675, (A, "self._watchdog.obeyed(master, wrote, now_ns)", "self._watchdog.obeyed(master, wrote and request.function != 15, now_ns)")),
    ("0.9 times its time", 871, (W, "self._fed_ns + self.time_ms * MS", "self._fed_ns + self.time_ms * MS * 9 // 10")),
    ("100 ms more", 871, (W, "self._fed_ns + self.time_ms * MS", "self._fed_ns + (self.time_ms + 100) * MS")),
    ("only the first write begins its time", 871, (W, "master, now_ns, now_ns\n", "master, now_ns, self._fed_ns if self.armed else now_ns\n")),
    ("trigger 1: diagnostics do not retrigger", 677, (A, "        self._watchdog.obeyed(master, wrote, now_ns)", "        if request.function != 8:\n            self._watchdog.obeyed(master, wrote, now_ns)")),
    ("trigger 1: what is refused retriggers", 677, (A, "            self.statistics.exceptions += 1", "            self.statistics.exceptions += 1\n            self._watchdog.obeyed(master, False, now_ns)")),
    ("trigger 0 is 1", 678, (W, "self._owner and self.trigger == TRIGGER_ANY", "self._owner")),
    ("takes trigger 2", 678, (W, "not in (TRIGGER_WRITES, TRIGGER_ANY)", "not in (TRIGGER_WRITES, TRIGGER_ANY, 2)")),
    ("a stranger retriggers", 679, (W, "elif master is self._owner and", "elif")),
    ("served after expiry", 683, (W, "        if self.expired:\n            return WATCHDOG_EXPIRED\n        return OWNED", "        if self.expired and writes:\n            return WATCHDOG_EXPIRED\n        return OWNED")),
    ("own registers are refused after expiry", 683, (A, "        if code == 0 and terminals:", "        if code == 0 and self._watchdog.expired and request.writes is None and request.function != 8:\n            code = 4\n        if code == 0 and terminals:")),
    ("ended by a closed connection", 683, (W, "        if self._owner is master:\n            self._owner = None\n        if self._resetting", "        self.expired = False\n        if self._owner is master:\n            self._owner = None\n        if self._resetting")),
    ("ended by clearing the counters", 683, (A, "                self._counted_from = dict", "                self._watchdog.expired = False\n                self._counted_from = dict")),
    ("keeps its outputs at expiry", 686, (A, "        self._image.clear_outputs()\n", "")),
    ("keeps its digital outputs at expiry", 686, (I, "        self._outputs = [0] * OUTPUT_IMAGE_WORDS\n\n    def words", "        self._outputs = [0] * OUTPUT_WORDS + self._outputs[OUTPUT_WORDS:]\n\n    def words")),
    ("a reset zeroes the time", 687, (W, RESETS, RESETS + "\n            self.time_ms = 1000")),
    ("a reset leaves it armed", 687, (W, RESETS, "            self.expired, self._owner = False, None")),
    ("the second word alone resets", 688, (W, "elif word != second or not half_done:", "elif word != second:")),
    ("two masters reset together", 688, (W, "half_done, self._resetting = self._resetting is master, None", "half_done, self._resetting = self._resetting is not None, None")),
    ("takes any word for the second", 688, (W, "elif word != second or not half_done:", "elif not half_done:")),
    ("a wrong word spoils nothing", 688, (W, "            return ILLEGAL_VALUE\n        else:", "            self._resetting = master if half_done else None\n            return ILLEGAL_VALUE\n        else:")),
    ("the time left stands still", 694, (W, "return -((now_ns - self.expires_at_ns()) // MS) if", "return self.time_ms if")),
    ("time is left while it is inactive", 694, (W, "if self.armed else 0", "if self.armed else self.time_ms")),
    ("an owner's closing stops it", 695, (W, "        if self._owner is master:\n            self._owner = None\n        if self._resetting", "        if self._owner is master:\n            self._owner, self.armed = None, False\n        if self._resetting")),
    ("an owner's closing begins its time anew", 695, (S, "        self.gone(connection)", "        self._watchdog._fed_ns = self.clock_ns()\n        self.gone(connection)")),
    ("reserved words are ones", 911, (B, "        return encode_sensors(", "        return [word if word or at < 30 else 0xFFFF for at, word in enumerate(encode_sensors("), (B, "190.0, 10.0, 40.0)\n        )", "190.0, 10.0, 40.0)\n        ))]")),
    ("the digital inputs are inverted", 911, (I, "words = [*words, words[_STATUS_WORD]]", "words = [*words, words[_STATUS_WORD] ^ 0xFFFF]")),
    ("the plant's cycle stands still", 912, (B, "cycle = now_ns // PLANT_CYCLE_NS", "cycle = 7")),
    ("4 reads the inputs of before", 912, (A, "        return self._image.words(*request.reads, now_ns)", "        now = self._image.words(*request.reads, now_ns)\n        before, self._before = getattr(self, '_before', now), now\n        return before if request.function == 4 and len(before) == len(now) else now")),
    ("the last input word is another", 922, (I, "            return words[begin:end]", "            return [*words[:39], words[39] + 1, *words[40:]][begin:end]")),
    ("the echo stands still", 913, (B, "self._valves.echo_cycle, status", "1, status")),
    ("a torn image acts", 914, (I, "            return 0, None, True", "            return 0, ValveImage(outputs[0], 0, (0.0,) * 6), True")),
    ("a torn image is not kept", 914, (I, "            self._outputs = outputs\n            return 0, None, True", "            return 0, None, True")),
    ("-32768 is taken in a torn image", 915, (I, '            if refusal.cause != "image.torn":', '            if outputs[0] == outputs[OUTPUT_WORDS - 1] and refusal.cause != "image.torn":')),
    ("-32768 is written although refused", 915, (I, "                return ILLEGAL_VALUE, None, False", "                self._outputs = outputs\n                return ILLEGAL_VALUE, None, False")),
    ("an image of zeros does not act", 923, (I, "        return 0, image, False", "        return 0, image if any(outputs) else None, False")),
    ("the zeros of an expiry do not act", 917, (A, "        self._on_valves(_CENTRED)\n", "")),
    ("a motion watchdog of 300 ms", 918, (B, "MOTION_WATCHDOG_NS = 100", "MOTION_WATCHDOG_NS = 300")),
    ("a motion watchdog of 80 ms", 918, (B, "MOTION_WATCHDOG_NS = 100", "MOTION_WATCHDOG_NS = 80")),
    ("any cycle ends the trip", 920, (B, "        self._valves.write(image, now_ns)", "        self._valves.write(ValveImage(image.controller_cycle, 0, image.valves), now_ns)\n        self._valves.write(image._replace(control=image.control | 2), now_ns)")),
    ("a reset clears the motion watchdog", 921, (A, "            return self._watchdog.configure(master, span.address, request.values[0], now_ns)", "            if request.values[0] == 0xAFFE:\n                self._on_valves(ValveImage(50, 0, (0.0,) * 6))\n                self._on_valves(ValveImage(51, 2, (0.0,) * 6))\n            return self._watchdog.configure(master, span.address, request.values[0], now_ns)")),
)
# fmt: on


class CouplerMutant(NamedTuple):
    """A coupler that is wrong, and the case that must find it."""

    name: str
    case: int
    edits: tuple[Edit, ...]

    def make(self, clock: ShiftedClock) -> ThreadedCoupler:
        """It, on the clock that the suite moves."""
        kind: Any = copies(MODULES, self.edits)[B].ThreadedCoupler
        kind.clock = clock
        made: ThreadedCoupler = kind()
        return made


MUTANTS = tuple(CouplerMutant(name, case, edits) for name, case, *edits in ROWS)
