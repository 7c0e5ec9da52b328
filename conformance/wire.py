"""The tester's socket: datagrams sound and unsound out, decoded ones in, all of them on the record."""

import select
import socket
import struct
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import count
from typing import Any, NamedTuple, TypeVar
from zlib import crc32

from conformance.noted import ENDINGS, Noted, went_on
from conformance.parts import OptionalPart
from protocol.authentication import ChannelKeys, DirectionKey, LinkKey, fault_of
from protocol.datagram import Datagram, Header, decode, encode
from protocol.datagram_layout import (
    CRC_BYTES,
    CRC_OFFSET,
    HEADER_BYTES,
    MAX_DATAGRAM_BYTES,
    TAG_BYTES,
    TRAILER_BYTES,
)
from protocol.errors import DatagramRefused
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    CAPABILITY_AUTHENTICATION,
    Bye,
    Command,
    Heartbeat,
    Message,
    State,
    Welcome,
)

LENGTH = 10
_AFTER_CRC = CRC_OFFSET + CRC_BYTES


def resealed(data: bytes, key: DirectionKey | None = None) -> bytes:
    """``data`` with its CRC, and with a ``key`` its tag, made right, to reach the checks behind them."""
    if key is not None and len(data) >= HEADER_BYTES + TRAILER_BYTES:
        data = data[:-TAG_BYTES] + key.tag(data[:-TAG_BYTES])
    checksum = crc32(data[_AFTER_CRC:], crc32(data[:CRC_OFFSET]))
    return data[:CRC_OFFSET] + struct.pack("<I", checksum) + data[_AFTER_CRC:]


def with_number(data: bytes, offset: int, code: str, value: float, key: DirectionKey | None = None) -> bytes:
    """``data`` with one number replaced and its CRC and tag made right."""
    bent = bytearray(data)
    struct.pack_into("<" + code, bent, offset, value)
    return resealed(bytes(bent), key)


def with_bit_flipped(data: bytes, bit: int) -> bytes:
    """``data`` with one bit flipped and nothing else."""
    bent = bytearray(data)
    bent[bit // 8] ^= 1 << bit % 8
    return bytes(bent)


MS = 1_000_000
ANSWER_MS = 400
SEQUENCES = 1 << 32
_EXTENDED_SEQUENCES = 1 << 64
_SESSION = slice(16, 24)
# So many answers the socket of any tester holds.
_HELD = 64

M = TypeVar("M", bound=Message)
K = TypeVar("K")


class Failed(Exception):
    """The peer did what the clause forbids, or not what it demands."""


class NoAnswer(Failed):
    """Nothing came back, or nobody is there."""


class Unsupported(Exception):
    """The peer lacks an optional ``part``, or is in no state to show it."""

    def __init__(self, why: str, part: OptionalPart | None = None) -> None:
        super().__init__(why)
        self.part = part


class Line(NamedTuple):
    """One datagram of a transcript; ``at_ms`` since the case began."""

    at_ms: float
    direction: str
    data: bytes


def require(condition: bool, why: str) -> None:
    """Raise Failed with ``why`` unless ``condition`` holds."""
    if not condition:
        raise Failed(why)


def known(value: K | None, why: str) -> K:
    """``value``; raises Failed with ``why`` where there is none."""
    if value is None:
        raise Failed(why)
    return value


class NonceSource:
    """Nonces and command ids that rise through a whole run, from a random start."""

    def __init__(self, start: int) -> None:
        self.noted = Noted()
        # Half of a nonce is none of the run, and below every id there is room.
        self.nonces = count(2**61 + start % 2**61 + 1)
        self.ids = count(((start % 2**21) << 32) + 2**16 + 1)


NO_WELCOME = Welcome(0, 0, 0, 0, 0, 0, 0)
"""Of a wire that no session was opened over."""


class Wire:
    """One UDP socket towards the controller under test, and the session that was opened over it.

    With a ``link_key`` everything is signed, and what comes must be.
    """

    def __init__(self, host: str, port: int, nonces: NonceSource, link_key: LinkKey | None = None) -> None:
        self.address = (host, port)
        self.link_key = link_key
        self._keys: dict[int, ChannelKeys] = {}
        self._nonces = nonces
        self.shift_ns = 0
        self._socket = self.new_socket()
        self._others: list[socket.socket] = []
        self._begin_ns = time.monotonic_ns()
        self.transcript: list[Line] = []
        self.moves = False
        self.session = 0
        self.minor = 0
        self.sequence = 0
        self.welcome = NO_WELCOME
        self.passed_over: list[Datagram] = []
        self._heartbeat_ns = 0
        self._unread, self._flooded = 0, False
        self._state: State | None = None

    def new_socket(self) -> socket.socket:
        """A socket from another port, towards the same controller."""
        family, _, _, _, address = socket.getaddrinfo(*self.address, type=socket.SOCK_DGRAM)[0]
        other = socket.socket(family, socket.SOCK_DGRAM)
        other.connect(address)
        other.setblocking(False)
        return other

    def close(self) -> None:
        """Stops an arm that ``moves``, ends the session politely and closes the sockets."""
        try:
            if self.session and self.moves:
                self.send(Command(self.new_id(), CommandCode.STOP))
            if self.session:
                self.send(Bye(Reason.SHUTDOWN))
        except OSError:
            pass
        for each in (self._socket, *self._others):
            each.close()

    @property
    def noted(self) -> Noted:
        """What the run has noted of this controller."""
        return self._nonces.noted

    @property
    def now_ns(self) -> int:
        """The tester's clock, ``shift_ns`` away from the machine's."""
        return time.monotonic_ns() + self.shift_ns

    @property
    def timeout_ms(self) -> int:
        """The link timeout that the controller announced."""
        return self.welcome.link_timeout_ms

    @property
    def grace_ms(self) -> float:
        """How long a decision of the controller may take: three scans, and what a busy machine adds."""
        return max(3 * self.welcome.cycle_ns / MS, 20.0) + 20.0

    @property
    def sequences(self) -> int:
        """The modulus of sequence numbers."""
        return SEQUENCES if self.link_key is None else _EXTENDED_SEQUENCES

    @property
    def hello_key(self) -> DirectionKey | None:
        """What HELLO is signed with."""
        return None if self.link_key is None else self.link_key.of_hello()

    @property
    def required(self) -> int:
        """The capability bits that HELLO must carry."""
        return 0 if self.link_key is None else CAPABILITY_AUTHENTICATION

    def nonce(self) -> int:
        """A nonce that this run has not used."""
        return next(self._nonces.nonces)

    def new_id(self) -> int:
        """A command id above all of this run."""
        return next(self._nonces.ids)

    # sending

    def send_raw(self, data: bytes) -> bytes:
        """Sends these bytes as they are."""
        self._note("send", data)
        self._unread += 1
        self._flooded |= self._unread > _HELD
        self._socket.send(data)
        return data

    def encoded(self, message: Message, *, sequence: int | None = None, sent_ns: int | None = None,
               session: int | None = None, minor: int | None = None, flags: int = 0) -> bytes:  # fmt: skip
        """A datagram of this session; with ``sequence`` None it takes the next number."""
        if sequence is None:
            self.sequence = sequence = (self.sequence + 1) % self.sequences
        header = Header(
            self.session if session is None else session,
            sequence,
            self.now_ns if sent_ns is None else sent_ns,
            flags=flags,
            minor=self.minor if minor is None else minor,
        )
        return encode(message, header, self.signs(header.session))

    def signs(self, session: int) -> DirectionKey | None:
        """What the datagrams of a session are signed with; HELLO's key where there is none."""
        return self._keys[session].sends if session in self._keys else self.hello_key

    def keys_of(self, session: int) -> ChannelKeys:
        """The keys of a session that this wire has opened."""
        return self._keys[session]

    def resealed(self, data: bytes) -> bytes:
        """Bent ``data`` with CRC and tag made right."""
        return resealed(data, self.signs(int.from_bytes(data[_SESSION], "little")))

    def with_number(self, data: bytes, offset: int, code: str, value: float) -> bytes:
        """``data`` with one number replaced and CRC and tag made right."""
        return with_number(data, offset, code, value, self.signs(int.from_bytes(data[_SESSION], "little")))

    def with_payload_of(self, data: bytes, size: int) -> bytes:
        """``data`` with a payload of ``size`` bytes, cut or filled up with zeros, and all else to match."""
        end = len(data) - (TRAILER_BYTES if self.link_key else 0)
        payload, trailer = data[HEADER_BYTES:end], data[end:]
        resized = data[:HEADER_BYTES] + payload[:size].ljust(size, b"\0") + trailer
        return self.with_number(resized, LENGTH, "H", size)

    def send(self, message: Message, **header: Any) -> bytes:
        """Seals, as ``encoded``, and sends."""
        return self.send_raw(self.encoded(message, **header))

    def beat(self) -> None:
        """Sends a heartbeat when one is due."""
        if self.session and self.now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = self.heartbeat() + self.timeout_ms * MS // 5

    def heartbeat(self, session: int | None = None) -> int:
        """Sends a heartbeat of now; returns its time, ns."""
        now_ns = self.now_ns
        self.send(Heartbeat(now_ns), sent_ns=now_ns, session=session)
        return now_ns

    def send_at_once(self, messages: Iterable[Message]) -> list[bytes]:
        """Sends these one right behind the other, all sealed before; their datagrams."""
        sealed = [self.encoded(message) for message in messages]
        return [self.send_raw(data) for data in sealed]

    def set_back(self, by_ns: int) -> None:
        """Sets the tester's clock back in the middle of a session; a heartbeat is due at once."""
        self.shift_ns -= by_ns
        self._heartbeat_ns = self.now_ns

    # receiving

    def receive(self, wait_ms: float, *, beating: bool = True) -> Datagram | None:
        """The next datagram within ``wait_ms``, or None; keeps the session alive meanwhile.

        Raises Failed when the controller sends what no receiver can decode.
        """
        until_ns = self.now_ns + int(wait_ms * MS)
        while True:
            if beating:
                self.beat()
            left_ns = until_ns - self.now_ns
            wake_ns = min(left_ns, self._heartbeat_ns - self.now_ns) if beating and self.session else left_ns
            ready, _, _ = select.select([self._socket], [], [], max(wake_ns, 0) / 1e9)
            if ready:
                return self._read_datagram()
            self._unread = 0
            if self.now_ns >= until_ns:
                return None

    def _read_datagram(self) -> Datagram | None:
        try:
            data = self._socket.recv(65_535)
        except ConnectionRefusedError as error:
            raise NoAnswer("nobody listens on the port") from error
        self._note("receive", data)
        if len(data) > MAX_DATAGRAM_BYTES:
            raise Failed(f"a datagram of {len(data)} bytes came: the limit is {MAX_DATAGRAM_BYTES}")
        try:
            datagram = decode(data)
        except DatagramRefused as error:
            raise Failed(f"a datagram came that cannot be decoded: {error}") from error
        self._authenticate(data, datagram)
        self.noted.look(data, datagram, whole=not self._flooded)
        message = went_on(datagram.message, self._state)
        self._state = message if isinstance(message, State) else self._state
        return datagram._replace(message=message)

    def _authenticate(self, data: bytes, datagram: Datagram) -> None:
        header, message = datagram
        key: DirectionKey | None = None
        if self.link_key is not None:
            if isinstance(message, Bye) and message.reason not in ENDINGS:
                return
            if isinstance(message, Welcome):
                keys = self.link_key.of_client(message.client_nonce, header.session, message.boot_id)
                self._keys.setdefault(header.session, keys)
            if header.session not in self._keys:
                raise Failed(f"a {type(message).__name__} of session {header.session:x}, never opened, came")
            key = self._keys[header.session].receives
        fault = fault_of(data, header.flags, key)
        require(fault is None, f"{type(message).__name__} came that a client must refuse: {fault}")

    def within(self, wait_ms: float) -> Iterator[float]:
        """Goes on for ``wait_ms``: what is left of it, ms, each time."""
        until_ns = self.now_ns + int(wait_ms * MS)
        while (left_ns := until_ns - self.now_ns) > 0:
            yield left_ns / MS

    def arriving(self, wait_ms: float, *, beating: bool = True) -> Iterator[Datagram]:
        """Each datagram that comes within ``wait_ms``, as it comes."""
        for left_ms in self.within(wait_ms):
            datagram = self.receive(left_ms, beating=beating)
            if datagram is not None:
                yield datagram

    def collect(self, wait_ms: float, *, beating: bool = True) -> list[Datagram]:
        """Everything that comes within ``wait_ms``."""
        return list(self.arriving(wait_ms, beating=beating))

    def require_came(
        self, wanted: Sequence[Message], wait_ms: float, why: str, *, of: Any = object, but: Any = (),
        beating: bool = False,
    ) -> None:  # fmt: skip
        """Require that these messages come within ``wait_ms``: of the kinds ``of``, none of ``but``."""
        got = [d.message for d in self.collect(wait_ms, beating=beating)]
        got = [message for message in got if isinstance(message, of) and not isinstance(message, but)]
        require(got == list(wanted), f"{why}: came {got}, wanted {wanted}")

    def drain(self) -> None:
        """Forgets what has come so far."""
        while self.receive(0.0, beating=False) is not None:
            pass

    def expect(self, kind: type[M], why: str, wait_ms: float = ANSWER_MS, *, beating: bool = True,
               wanted: Callable[[M], bool] = lambda message: True) -> M:  # fmt: skip
        """The next ``wanted`` message of ``kind`` within ``wait_ms``; raises Failed.

        Messages of other kinds go to ``passed_over``.
        """
        for datagram in self.arriving(wait_ms, beating=beating):
            if not isinstance(datagram.message, kind):
                self.passed_over.append(datagram)
            elif wanted(datagram.message):
                return datagram.message
        raise Failed(f"{why}: no {kind.__name__} within {wait_ms:g} ms")

    def expect_bye(self, reason: Reason, why: str, wait_ms: float = ANSWER_MS) -> None:
        """A BYE with ``reason``; raises Failed."""
        got = self.expect(Bye, why, wait_ms, beating=False).reason
        require(got is reason, f"{why}: BYE {got.name}, wanted {reason.name}")
        self.session = 0 if got is Reason.LINK_TIMEOUT else self.session

    def _note(self, direction: str, data: bytes) -> None:
        self.transcript.append(Line((time.monotonic_ns() - self._begin_ns) / MS, direction, data))
