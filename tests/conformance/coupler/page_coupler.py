"""A coupler written from docs/process_image.md, not from ours: every decision is looked up in its rules."""

import struct

from tests.conformance.coupler.page_watchdog import PagePlant, PageWatchdog
from tests.conformance.coupler.rules import INPUTS, OUTPUTS, RESET, TIME, TRIGGER, Rules, Spans

ANALOG_OUTPUTS = 12
_BITS = (1, 2, 5, 15)
_EMPTY_HEAD = {15: 5, 16: 5, 23: 9}
_FUNCTION, _ADDRESS, _VALUE, _EXPIRED, _OWNED = 1, 2, 3, 4, 6


def within(spans: Spans, address: int, count: int) -> bool:
    """Whether ``count`` addresses from ``address`` on lie within one span."""
    return any(begin <= address and address + count <= begin + size for begin, size in spans)


class Request:
    """A request taken apart; what is missing in a short one counts as zero."""

    def __init__(self, pdu: bytes) -> None:
        self.pdu, self.function = pdu, pdu[0]
        whole = pdu.ljust(10, b"\0")
        self.write_at, self.write_count = struct.unpack_from(">HH", whole, 5 if self.function == 23 else 1)
        self.read_at, self.read_count = struct.unpack_from(">HH", whole, 1)
        if self.function in (5, 6):
            self.write_count = 1
        self.reads = self.function in (1, 2, 3, 4, 23)
        self.writes = self.function in (5, 6, 15, 16, 23)

    @property
    def own(self) -> bool:
        """Whether it concerns the coupler's own registers."""
        if self.function in _BITS:
            return False
        return (self.write_at if self.writes else self.read_at) >= 0x1000

    @property
    def kind(self) -> str:
        """What it is to the watchdog."""
        return f"{self.function} own" if self.own and self.function != 8 else str(self.function)

    @property
    def words(self) -> list[int]:
        """The words that it writes."""
        if self.function == 6:
            return [int.from_bytes(self.pdu[3:5], "big")]
        data = self.pdu[_EMPTY_HEAD[self.function] + 1 :][: 2 * self.write_count]
        return list(struct.unpack(f">{len(data) // 2}H", data[: len(data) // 2 * 2]))


class PageCoupler:
    """The answers; ``answer`` and ``lost`` are all that a connection needs. Masters are any objects."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.plant = PagePlant(rules)
        self.watchdog = PageWatchdog(rules)
        self.outputs = [0] * OUTPUTS[1]
        self.counts = {"requests": 0, "frames": 0, "exceptions": 0}
        self._names = 0
        self._shown = [0] * INPUTS[1]

    # what connections tell

    def lost(self) -> None:
        """A frame without a place in the stream came."""
        self.counts["frames"] += "frames" in self.rules.counted

    def closed(self, master: object, now_ns: int) -> None:
        """A connection has ended."""
        self._look(now_ns)
        self.watchdog.closed(master, now_ns)

    def answer(self, master: object, pdu: bytes, now_ns: int) -> bytes:
        """The response to a request."""
        self._look(now_ns)
        request = Request(pdu)
        code = self._refusal(request, master, now_ns)
        self._count(code)
        if code:
            if (request.function, code) in self.rules.refused_but_written:
                self._write_what_can_be(request, now_ns)
            self.watchdog.refused(master, code, now_ns)
            return self.rules.refusal(request.function, code)
        return self._carried_out(request, master, now_ns)

    # checks

    def _refusal(self, request: Request, master: object, now_ns: int) -> int:
        checks = {
            "function": lambda: 0 if request.function in self.rules.functions else _FUNCTION,
            "length": lambda: self._length(request),
            "address": lambda: self._address(request),
            "watchdog": lambda: self._expired(request, master),
            "owner": lambda: self._owned(request, master, now_ns),
            "value": lambda: self._value(request, master),
        }
        for name in self.rules.order_of.get(request.function, self.rules.order):
            code = checks[name]()
            if code:
                return code
        return 0

    def _length(self, request: Request) -> int:
        function, pdu, rules = request.function, request.pdu, self.rules
        if function == 8:
            return self._diagnostics_refusal(pdu)
        if function not in (*rules.most_read, 5, 6, *rules.most_written):
            return 0
        expected = 5
        if function in _EMPTY_HEAD:
            head = _EMPTY_HEAD[function]
            unit = (request.write_count + 7) // 8 if function == 15 else 2 * request.write_count
            if len(pdu) <= head:
                return 0 if ("short", function) in rules.no_check else _VALUE
            if pdu[head] != unit and ("count", function) not in rules.no_check:
                return _VALUE
            expected = head + 1 + (pdu[head] if ("count", function) not in rules.no_check else unit)
        if len(pdu) < expected and ("short", function) not in rules.no_check:
            return _VALUE
        if len(pdu) > expected and ("long", function) not in rules.no_check:
            return _VALUE
        if function == 5 and int.from_bytes(pdu[3:5], "big") not in rules.coil_words:
            return _VALUE
        least = rules.least.get(function, 1)
        if request.reads and not least <= request.read_count <= rules.most_read[function]:
            return _VALUE
        most = rules.most_written.get(function)
        return _VALUE if most is not None and not least <= request.write_count <= most else 0

    def _diagnostics_refusal(self, pdu: bytes) -> int:
        if len(pdu) < 3:
            return _VALUE
        sub, data = int.from_bytes(pdu[1:3], "big"), pdu[3:]
        if self.rules.data_before_sub_function and len(data) != 2 and sub != 0:
            return _VALUE
        if sub not in self.rules.sub_functions:
            return _FUNCTION
        if sub in self.rules.zero_data:
            return 0 if data == b"\0\0" else _VALUE
        if len(data) < 2 and ("short", 8) not in self.rules.no_check:
            return _VALUE
        return _VALUE if len(data) % 2 and ("odd", 8) not in self.rules.no_check else 0

    def _address(self, request: Request) -> int:
        function, rules = request.function, self.rules
        if request.reads and not within(rules.reads[function], request.read_at, request.read_count):
            return _ADDRESS
        if request.writes and not within(rules.writes[function], request.write_at, request.write_count):
            return _ADDRESS
        return 0

    def _expired(self, request: Request, master: object) -> int:
        if not self.watchdog.expired or request.function == 8:
            return 0
        if request.own:
            return 0 if self.rules.own_after_expiry else _EXPIRED
        if self.rules.silences == "owner" and master is not self.watchdog.last_owner:
            return 0
        return _EXPIRED if request.function in self.rules.silenced else 0

    def _owned(self, request: Request, master: object, now_ns: int) -> int:
        if not self.watchdog.is_owned_by_another(master, now_ns):
            return 0
        if request.kind in self.rules.closed_to_others:
            return _OWNED
        guarded = request.write_at if request.own else request.function
        return _OWNED if request.writes and guarded in self.rules.guarded else 0

    def _value(self, request: Request, master: object) -> int:
        if not request.writes or request.function in _BITS:
            return 0
        if request.own:
            return self.watchdog.value_refusal(master, request.write_at, request.words[0])
        after = self._after(request)
        begin, count = self.rules.spools
        spools = after[begin - OUTPUTS[0] :][:count]
        torn = after[0] != after[ANALOG_OUTPUTS - 1]
        return _VALUE if 0x8000 in spools and (self.rules.spools_of_torn_images or not torn) else 0

    # actions

    def _carried_out(self, request: Request, master: object, now_ns: int) -> bytes:
        function = request.function
        self.watchdog.carried_out(master, request.kind, now_ns)
        if function == 8:
            return self._diagnosed(request.pdu)
        reads_first = request.reads and not self.rules.writes_first
        before = self._read(request, now_ns) if reads_first else b""
        if request.writes:
            self._write(request, master, now_ns)
        if not request.reads:
            return self.rules.short_answer(request.pdu)
        data = before if reads_first else self._read(request, now_ns)
        return bytes([function, len(data)]) + data

    def _after(self, request: Request) -> list[int]:
        outputs = list(self.outputs)
        at = request.write_at - OUTPUTS[0]
        for place, word in enumerate(request.words, at):
            if 0 <= place < len(outputs):
                outputs[place] = word
        return outputs

    def _write(self, request: Request, master: object, now_ns: int) -> None:
        if request.own:
            if self.watchdog.configure(master, request.write_at, request.words[0], now_ns):
                self.plant.coupler_reset()
                if "outputs" in self.rules.reset_clears:
                    self.outputs = [0] * OUTPUTS[1]
            return
        if request.function in _BITS:
            self._write_bits(request)
            return
        after = self._after(request)
        whole = after[0] == after[ANALOG_OUTPUTS - 1]
        analog = request.write_at < OUTPUTS[0] + ANALOG_OUTPUTS
        if whole or not analog or self.rules.torn_is_kept:
            self.outputs = after
        if analog and (whole or self.rules.torn_acts):
            self.plant.take(after[:ANALOG_OUTPUTS], now_ns)

    def _write_bits(self, request: Request) -> None:
        if request.function == 5:
            bits = [self.rules.coil_words[int.from_bytes(request.pdu[3:5], "big")]]
        else:
            data = request.pdu[6:]
            count = 8 * len(data) if self.rules.bits_beyond else request.write_count
            places = [self.rules.coil_from(at) for at in range(min(count, 8 * len(data)))]
            bits = [bool(data[at // 8] >> at % 8 & 1) for at in places]
        for at, bit in enumerate(bits, request.write_at):
            if self.rules.coil_clears_others:
                self.outputs[-1] = 0
            at = self.rules.coil_place(at)
            if at < 16:
                self.outputs[-1] = self.outputs[-1] | 1 << at if bit else self.outputs[-1] & ~(1 << at)

    def _write_what_can_be(self, request: Request, now_ns: int) -> None:
        try:
            if request.function in _BITS:
                self._write_bits(request)
            elif not request.own:
                self.outputs = self._after(request)
            else:
                self.watchdog.configure(None, request.write_at, request.words[0], now_ns)
        except (KeyError, IndexError, struct.error):
            pass

    def _read(self, request: Request, now_ns: int) -> bytes:
        address, count = request.read_at, request.read_count
        if request.function in (1, 2):
            word = self.outputs[-1] if request.function == 1 else self._inputs(now_ns)[-1]
            size = (count + 7) // 8
            bits = word >> address
            mask = (1 << count) - 1
            fill = self.rules.fills_with.get(request.function, 0)
            return (bits & mask | fill & ~mask).to_bytes(8, "little")[:size]
        if address < OUTPUTS[0]:
            now = self._inputs(now_ns)
            before, self._shown = self._shown, now
            stale = request.function in self.rules.of_the_request_before
            words = self.rules.delivers(request.function, before if stale else now)[address - INPUTS[0] :]
        elif address < 0x1000:
            words = self.outputs[address - OUTPUTS[0] :]
        else:
            words = [self._own(at, now_ns) for at in range(address, address + count)]
        words = (words + [0] * count)[:count]
        return struct.pack(f">{count}H", *words)

    def _inputs(self, now_ns: int) -> list[int]:
        words = self.plant.words(self.outputs[0], now_ns)
        return [*words, self.rules.digital_inputs(words[3])]

    def _own(self, address: int, now_ns: int) -> int:
        if address < 0x1007:
            self._names += 1
            at = 2 * (address - 0x1000)
            return int.from_bytes(self.rules.name(self._names)[at : at + 2], "little")
        lengths = dict(zip(range(0x1010, 0x1014), self.rules.lengths, strict=True))
        watchdog = self.watchdog
        return {
            **lengths, 0x100C: self._status(), 0x1020: watchdog.left(now_ns),
            TIME: watchdog.time_ms, RESET: watchdog.shown_word, TRIGGER: watchdog.trigger,
        }.get(address, 0)  # fmt: skip

    def _status(self) -> int:
        return self.rules.status_expired if self.watchdog.expired else self.rules.status

    def _diagnosed(self, pdu: bytes) -> bytes:
        what = self.rules.sub_functions[int.from_bytes(pdu[1:3], "big")]
        if what == "clear":
            for name in self.rules.cleared:
                self.counts[name] = 0
        if what == "echo":
            return self.rules.echoes(pdu)
        if what == "clear":
            return pdu
        answer = self._status() if what == "status" else self.counts.get(what, 0)
        return pdu[:3] + struct.pack(">H", answer & 0xFFFF)

    def _count(self, code: int) -> None:
        counted = self.rules.counted
        self.counts["requests"] += "refused requests" in counted if code else "requests" in counted
        self.counts["exceptions"] += bool(code) and "exceptions" in counted

    def _look(self, now_ns: int) -> None:
        if not self.watchdog.expires(now_ns):
            return
        if "analog" in self.rules.zeroes:
            self.outputs[:ANALOG_OUTPUTS] = [0] * ANALOG_OUTPUTS
        if "digital" in self.rules.zeroes:
            self.outputs[ANALOG_OUTPUTS:] = [0]
        if self.rules.zeroes_act:
            self.plant.take([0] * ANALOG_OUTPUTS, now_ns)
