"""A program's variables over ADS: what is asked by name, handle or place is answered from its memory.

No clock and no socket: times are handed in. Beckhoff, TE1000: commands, index groups, sum commands.
There is no authentication in ADS; ``writable`` lets whoever is connected change numbers.
"""

import itertools
import struct
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from controller_st.ads_frames import ADS_COMMAND, MAX_FRAME, AdsCommand, AdsError, AmsAddress, AmsFrame
from controller_st.ads_symbols import DATA_GROUP, Symbol, SymbolTable, is_number, type_entry
from structured_text.memory import MemoryView

PORT = 851
"""The AMS port of the first PLC program."""

HANDLES, NOTIFICATIONS, SUMMED = 1024, 256, 500
"""How many each connection may have, and how many a sum command may hold."""

_HANDLE_BY_NAME, _VALUE_BY_NAME, _VALUE_BY_HANDLE, _RELEASE = 0xF003, 0xF004, 0xF005, 0xF006
_VERSION, _INFO_BY_NAME, _UPLOAD, _UPLOAD_INFO = 0xF008, 0xF009, 0xF00B, 0xF00C
_TYPE_UPLOAD, _UPLOAD_INFO_2, _TYPE_BY_NAME = 0xF00E, 0xF00F, 0xF011
_SUM_READ, _SUM_WRITE, _SUM_READ_WRITE = 0xF080, 0xF081, 0xF082
_SUM_HEADS = {
    _SUM_READ: struct.Struct("<III"),
    _SUM_WRITE: struct.Struct("<III"),
    _SUM_READ_WRITE: struct.Struct("<IIII"),
}
_WITH_MORE = (
    AdsCommand.READ,
    AdsCommand.READ_WRITE,
    AdsCommand.ADD_NOTIFICATION,
)  # length or handle behind the code
_WATCHED = 4096  # bytes of a notification
_RUN = 5  # ADSSTATE_RUN
_ON_CHANGE, _CYCLIC = 4, 3
_NAME = b"Longreach ST PLC"
_HUNDRED_NS = 100
_What = TypeVar("_What")


class Refused(Exception):
    """Answered with a return code."""

    def __init__(self, code: AdsError) -> None:
        super().__init__(code.name)
        self.code = code


def _require(holds: bool, code: AdsError) -> None:
    if not holds:
        raise Refused(code)


def _found(what: _What | None, code: AdsError = AdsError.SYMBOL_NOT_FOUND) -> _What:
    if what is None:
        raise Refused(code)
    return what


class _Watch(NamedTuple):
    """A notification: what it watches, and when it is due. Times in ns."""

    place: tuple[int, int]
    on_change: bool
    every_ns: int
    due_ns: int
    last: bytes | None


class AdsClient:
    """What the device knows of one connection."""

    def __init__(self) -> None:
        self.handles: dict[int, Symbol] = {}
        self.watches: dict[int, _Watch] = {}
        self.peer: tuple[AmsAddress, AmsAddress] | None = None
        self.refused = 0
        self.numbers = itertools.count(1)
        """Numbers that no handle of this connection has had."""


class AdsDevice:
    """Answers frames from the memory of a program that is not running meanwhile."""

    def __init__(
        self, memory: MemoryView, *, writable: bool = False, least_cycle_ns: int = 1_000_000
    ) -> None:
        """``least_cycle_ns``: no notification comes more often."""
        self.table = SymbolTable(memory)
        self._data, self._writable, self._least_ns = memory.data, writable, least_cycle_ns
        self._commands: dict[int, Callable[[AdsClient, bytes, int], bytes]] = {
            AdsCommand.DEVICE_INFO: lambda *_: struct.pack("<IBBH16s", 0, 3, 1, 0, _NAME),
            AdsCommand.READ: self._read_command,
            AdsCommand.WRITE: self._write_command,
            AdsCommand.READ_STATE: lambda *_: struct.pack("<IHH", 0, _RUN, 0),
            AdsCommand.ADD_NOTIFICATION: self._add_notification,
            AdsCommand.DELETE_NOTIFICATION: self._delete_notification,
            AdsCommand.READ_WRITE: self._read_write_command,
        }

    def answer(self, client: AdsClient, frame: AmsFrame, now_ns: int) -> AmsFrame:
        """The answer to a request; what cannot be done is answered by its return code, and counted."""
        if frame.target.port != PORT and frame.command != AdsCommand.READ_STATE:
            client.refused += 1
            return frame.answered(b"", AdsError.PORT_NOT_FOUND)
        client.peer = frame.source, frame.target
        command = self._commands.get(frame.command)
        try:
            if command is None:
                raise Refused(AdsError.SERVICE_NOT_SUPPORTED)
            return frame.answered(command(client, frame.data, now_ns))
        except (Refused, struct.error) as error:
            client.refused += 1
            code = error.code if isinstance(error, Refused) else AdsError.INVALID_SIZE
            size = 8 if frame.command in _WITH_MORE else 4
            return frame.answered(struct.pack("<I", code).ljust(size, b"\0"))

    def due(self, client: AdsClient, now_ns: int, wall_ns: int) -> AmsFrame | None:
        """A frame with the samples that are due at ``now_ns``; ``wall_ns``: since 1970, for their stamp."""
        samples = []
        for handle, watch in client.watches.items():
            if watch.due_ns > now_ns:
                continue
            at, size = watch.place
            value = bytes(self._data[at : at + size])
            due_ns = max(watch.due_ns + watch.every_ns, now_ns)  # a late one is not made up for
            if not watch.on_change or value != watch.last:
                samples.append(struct.pack("<II", handle, size) + value)
            client.watches[handle] = watch._replace(due_ns=due_ns, last=value)
        if not samples or client.peer is None:
            return None
        stamp = wall_ns // _HUNDRED_NS + 116_444_736_000_000_000  # 100 ns since 1601
        body = struct.pack("<IQI", 1, stamp, len(samples)) + b"".join(samples)
        data = struct.pack("<I", len(body)) + body
        return AmsFrame(*client.peer, AdsCommand.NOTIFICATION, ADS_COMMAND, 0, 0, data)

    def _read_command(self, client: AdsClient, data: bytes, _: int) -> bytes:
        group, offset, length = struct.unpack("<III", data)
        found = self._read(client, group, offset, length)
        return struct.pack("<II", 0, len(found)) + found

    def _write_command(self, client: AdsClient, data: bytes, _: int) -> bytes:
        group, offset, length = struct.unpack_from("<III", data)
        _require(len(data) == 12 + length, AdsError.INVALID_SIZE)
        self._write(client, group, offset, data[12:])
        return struct.pack("<I", 0)

    def _read_write_command(self, client: AdsClient, data: bytes, _: int) -> bytes:
        group, offset, length, written = struct.unpack_from("<IIII", data)
        _require(len(data) == 16 + written, AdsError.INVALID_SIZE)
        is_sum = group >= _SUM_READ
        parts = data[16:]
        found = (
            self._summed(client, group, offset, parts) if is_sum else self._read_write(client, group, parts)
        )
        _require(len(found) <= min(length, MAX_FRAME // 2), AdsError.INVALID_SIZE)
        return struct.pack("<II", 0, len(found)) + found

    def _read(self, client: AdsClient, group: int, offset: int, length: int) -> bytes:
        if group == _VALUE_BY_HANDLE:
            symbol = _found(client.handles.get(offset))
            _require(length >= symbol.type.size, AdsError.INVALID_SIZE)
            return self._value(symbol)
        if group == DATA_GROUP:
            return self._bytes(offset, length)
        whole = self._described(group)
        _require(length >= len(whole), AdsError.INVALID_SIZE)
        return whole

    def _described(self, group: int) -> bytes:
        table = self.table
        counts = len(table.symbols), len(table.upload), len(table.types), len(table.type_upload)
        described = {
            _VERSION: b"\1",
            _UPLOAD: table.upload,
            _UPLOAD_INFO: struct.pack("<II", *counts[:2]),
            _TYPE_UPLOAD: table.type_upload,
            _UPLOAD_INFO_2: struct.pack("<IIIIII", *counts, 0, 0),
        }
        _require(group in described, AdsError.INVALID_GROUP)
        return described[group]

    def _read_write(self, client: AdsClient, group: int, written: bytes) -> bytes:
        name = written.split(b"\0")[0].decode("latin-1")
        if group == _TYPE_BY_NAME:
            return type_entry(_found(self.table.types.get(name.strip().upper())))  # type: ignore[arg-type]
        _require(group in (_HANDLE_BY_NAME, _VALUE_BY_NAME, _INFO_BY_NAME), AdsError.INVALID_GROUP)
        symbol = _found(self.table.find(name))
        if group == _INFO_BY_NAME:
            return symbol.entry
        if group == _VALUE_BY_NAME:
            return self._value(symbol)
        _require(len(client.handles) < HANDLES, AdsError.NO_MEMORY)
        handle = next(client.numbers)
        client.handles[handle] = symbol
        return struct.pack("<I", handle)

    def _write(self, client: AdsClient, group: int, offset: int, value: bytes) -> None:
        if group == _RELEASE:
            _found(client.handles.pop(struct.unpack("<I", value)[0], None))
            return
        _require(group in (_VALUE_BY_HANDLE, DATA_GROUP) and self._writable, AdsError.INVALID_ACCESS)
        by_place = group == DATA_GROUP
        known = self.table.at(offset, len(value)) if by_place else client.handles.get(offset)
        symbol = _found(known, AdsError.INVALID_OFFSET if by_place else AdsError.SYMBOL_NOT_FOUND)
        _require(len(value) == symbol.type.size, AdsError.INVALID_SIZE)
        is_bool = symbol.type.name == "BOOL" and value in (b"\0", b"\1")
        _require(is_bool or is_number(symbol.type), AdsError.INVALID_DATA)
        self._data[symbol.offset : symbol.offset + len(value)] = value

    def _summed(self, client: AdsClient, group: int, count: int, written: bytes) -> bytes:
        """Of ``count`` reads, writes or both, each with a return code of its own."""
        _require(group in _SUM_HEADS, AdsError.SERVICE_NOT_SUPPORTED)
        form = _SUM_HEADS[group]
        at = form.size * count
        _require(count <= SUMMED and len(written) >= at, AdsError.INVALID_SIZE)
        codes, values, length = [], [], 0
        for head in form.iter_unpack(written[:at]):
            part = b"" if group == _SUM_READ else written[at : at + head[-1]]
            at += len(part)
            code, value = self._one_of_sum(client, group, head, part)
            values.append(value)
            length += len(value)
            _require(length <= MAX_FRAME // 2, AdsError.INVALID_SIZE)
            codes.append(
                struct.pack("<II", code, len(value)) if group == _SUM_READ_WRITE else struct.pack("<I", code)
            )
        return b"".join(codes) + b"".join(values)

    def _one_of_sum(
        self, client: AdsClient, group: int, head: tuple[int, ...], part: bytes
    ) -> tuple[AdsError, bytes]:
        """A failed read has as many bytes as were asked for: those of the others keep their places."""
        try:
            if group == _SUM_READ:
                return AdsError.NONE, self._read(client, *head[:3]).ljust(min(head[2], MAX_FRAME), b"\0")
            _require(len(part) == head[-1], AdsError.INVALID_SIZE)
            if group == _SUM_READ_WRITE:
                return AdsError.NONE, self._read_write(client, head[0], part)
            self._write(client, head[0], head[1], part)
        except Refused as refusal:
            return refusal.code, b"\0" * min(head[2], MAX_FRAME) if group == _SUM_READ else b""
        return AdsError.NONE, b""

    def _add_notification(self, client: AdsClient, data: bytes, now_ns: int) -> bytes:
        group, offset, length, mode, _, cycle = struct.unpack_from("<IIIIII", data)
        _require(mode in (_ON_CHANGE, _CYCLIC), AdsError.SERVICE_NOT_SUPPORTED)
        _require(len(client.watches) < NOTIFICATIONS, AdsError.NO_MEMORY)
        if group == _VALUE_BY_HANDLE:
            symbol = _found(client.handles.get(offset))
            offset, length = symbol.offset, min(length, symbol.type.size)
        elif group != DATA_GROUP:
            raise Refused(AdsError.INVALID_GROUP)
        _require(length <= _WATCHED, AdsError.INVALID_SIZE)
        self._bytes(offset, length)
        handle, every_ns = next(client.numbers), max(_HUNDRED_NS * cycle, self._least_ns)
        client.watches[handle] = _Watch((offset, length), mode == _ON_CHANGE, every_ns, now_ns, None)
        return struct.pack("<II", 0, handle)

    def _delete_notification(self, client: AdsClient, data: bytes, _: int) -> bytes:
        _found(client.watches.pop(struct.unpack("<I", data)[0], None), AdsError.INVALID_NOTIFICATION)
        return struct.pack("<I", 0)

    def _value(self, symbol: Symbol) -> bytes:
        return self._bytes(symbol.offset, symbol.type.size)

    def _bytes(self, offset: int, length: int) -> bytes:
        _require(length <= MAX_FRAME // 2, AdsError.INVALID_SIZE)
        _require(offset + length <= len(self._data), AdsError.INVALID_OFFSET)
        return bytes(self._data[offset : offset + length])
