"""Authentication: keys after their standard, tags over every byte, the window of sequence numbers."""

import hmac

import pytest

from conformance.wire import resealed
from protocol.authentication import DirectionKey, LinkKey, fault_of
from protocol.channel import Arrival, SequenceWindow
from protocol.datagram import decode, encode
from protocol.datagram_layout import HEADER_BYTES, TRAILER_BYTES
from protocol.errors import DatagramRefused
from protocol.faults import CommandCode
from protocol.reference_messages import (
    Command,
    Message,
)
from tests.protocol.sample_messages import HEADER, MESSAGES

SECRET = bytes(range(32))
KEY = LinkKey(SECRET)
OTHER = LinkKey(bytes(32))
STOP = Command(1, CommandCode.STOP)


class TestKeys:
    def test_hmac_is_that_of_rfc_4231(self) -> None:
        """Test case 2 of RFC 4231; the tag leaves bytes 12…15 out, so the text is laid around them."""
        text = b"what do ya want for nothing?"
        tag = DirectionKey(b"Jefe", 0).tag(text[:12] + b"CRC!" + text[12:])
        assert tag.hex() == "5bdcc146bf60754e6a042426089575c7"

    def test_every_session_and_direction_has_its_own(self) -> None:
        data = bytes(64)
        tags = [KEY.of_hello().tag(data)]
        for numbers in ((1, 2, 3), (4, 2, 3), (1, 4, 3), (1, 2, 4), (2, 1, 3)):
            tags += [key.tag(data) for key in KEY.of_client(*numbers)]
        tags += [key.tag(data) for key in OTHER.of_client(1, 2, 3)]
        assert len(set(tags)) == len(tags)
        client, controller = KEY.of_client(1, 2, 3), KEY.of_controller(1, 2, 3)
        assert client.sends.tag(data) == controller.receives.tag(data)
        assert client.receives.tag(data) == controller.sends.tag(data)

    def test_a_short_secret_is_refused(self) -> None:
        with pytest.raises(ValueError, match="31 bytes"):
            LinkKey(bytes(31))


class TestTag:
    @pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
    def test_signed_datagrams_carry_the_message_and_a_64_bit_number(self, message: Message) -> None:
        key = KEY.of_hello()
        header = HEADER._replace(sequence=0x0123_4567_89AB_CDEF)
        data = encode(message, header, key)
        assert len(data) == len(encode(message, HEADER)) + TRAILER_BYTES
        got = decode(data)
        assert got.message == message
        assert got.header.sequence == header.sequence
        assert data[HEADER_BYTES:-TRAILER_BYTES] == encode(message, HEADER)[HEADER_BYTES:]
        assert fault_of(data, got.header.flags, key) is None
        assert data[-24:-20] == bytes.fromhex("67452301")
        assert data[-20:-16] == KEY.key_id.to_bytes(4, "little")
        secret = hmac.digest(SECRET, b"\0\0\0\1LRLK 1 hello\0\0\0\1\0", "sha256")
        assert data[-16:] == hmac.digest(secret, data[:12] + data[16:-16], "sha256")[:16]

    def test_no_bit_can_be_changed(self) -> None:
        """With the CRC made right each time, so that nothing but the tag stands in the way."""
        key = KEY.of_hello()
        data = encode(STOP, HEADER, key)
        for bit in range(8 * len(data)):
            bent = bytearray(data)
            bent[bit // 8] ^= 1 << bit % 8
            encoded = resealed(bytes(bent))
            if encoded == data:  # the bit was one of the CRC's
                continue
            try:
                flags = decode(encoded).header.flags
            except DatagramRefused:
                continue
            fault = fault_of(encoded, flags, key)
            assert fault in ("authentication.bad_tag", "authentication.unknown_key"), bit

    def test_each_refusal_has_its_own_cause(self) -> None:
        plain, signed = encode(STOP, HEADER), encode(STOP, HEADER, KEY.of_hello())
        flags = decode(signed).header.flags
        assert fault_of(plain, 0, None) is None
        assert fault_of(plain, 0, KEY.of_hello()) == "authentication.missing"
        assert fault_of(signed, flags, None) == "authentication.no_key"
        assert fault_of(signed, flags, OTHER.of_hello()) == "authentication.unknown_key"
        assert fault_of(signed, flags, KEY.of_client(1, 2, 3).sends) == "authentication.bad_tag"


class TestWindow:
    def test_numbers_of_64_bits_do_not_wrap_at_32(self) -> None:
        window = SequenceWindow(2**32 - 2, 2**64)
        assert window.arrive(2**32 - 1) == (Arrival.NEW, 0)
        assert window.arrive(2**32 + 1) == (Arrival.NEW, 1)
        assert window.arrive(2**32) == (Arrival.LATE, 0)
        assert window.arrive(2**32) == (Arrival.DUPLICATE, 0)
        assert window.arrive(1) == (Arrival.OLD, 0)  # modulo 2^32 it would be the next
        assert window.arrive(2**33) == (Arrival.JUMP, 0)
        assert window.newest == 2**32 + 1
