# ruff: noqa: E501  (a row is read beside the line that it changes)
"""The code of the link changed in one place each: what a programmer of a controller may have misread.

Each row: what the controller then does, the cases that must catch it, and the edits.
"""

from conformance.runner import reference_cases
from tests.conformance.mutator import KEY, BrokenController, edited

A, D, C, L, F, S, I = "authentication", "datagram", "channel", "ledger", "factory", "server", "inbox"  # noqa: E741
LENGTH = "if payload_bytes != size - HEADER_BYTES - after_payload:"
CRC = "if checksum != crc32("
DUPLICATE = (C, "return Arrival.DUPLICATE, 0", "return Arrival.NEW, 0")
AHEAD = "ahead = (sequence - self.newest) % self._modulus"
HALF_A_WINDOW = (C, "if behind >= WINDOW_DATAGRAMS:", "if behind >= 32:")
NUMBER = "number = self.next_sequence % self._modulus"
STAMPS = "message._replace(replied_ns=sent_ns)"
HEADER = "Header(self.session, number, now_ns, echo, flags, self.minor)"
GRANTED = "hello.capabilities & self._capabilities"
OCCUPIED = "if session and source != session.source:"
SOURCE = "        if source != session.source:"
GREETED = "        return []\n\n    def _confirmed"
EXPIRED = "unconfirmed.greeted_ns > self._link_timeout_ms * NS_PER_MS"
USED = (
    "dropped = session.channel.hear(header, now_ns, self._max_age_ns, self._tally)\n        if dropped is not"
)
IS_BYE = "if isinstance(message, Bye):\n            if session is"
TIMEOUT = "            self._link_timeout_ms,\n"
SESSION_NUMBER = "number = _session_number(self._secret, self._boot_id, hello.client_nonce, self.count)"
ANSWER = "            self._send(acknowledgement, now_ns)"
REFERENCES_WAIT = (I, "if not isinstance(request, Command):", "if False:")
ONE_A_SCAN = (I, "_REQUESTS_A_SCAN = 8", "_REQUESTS_A_SCAN = 1")
CLOSED = "elif isinstance(event, SessionClosed):"
# For as long as the link may be silent it counts as alive, although its session has ended.
LIVES_ON = (
    (S, "self._session.channel.heard_ns if self._session else None",
     "self._session.channel.heard_ns if self._session else getattr(self, '_gone_ns', None)"),
    (S, "        self._session = None\n        return SessionClosed",
     "        self._session, self._gone_ns = None, now_ns\n        return SessionClosed"),
)  # fmt: skip
CONTENT = "waypoints = tuple(_pose(numbers, at) for at in range(2, 2 + 7 * count, 7)"
POSE = "    x, y, z, qw, qx, qy, qz = numbers[at : at + 7]\n"
NEGOTIATED = "if needed_capability(request) & ~session.welcome.capabilities"
HELLO_TAG = "forged = unauthentic(data, datagram.header, key, self._tally)"
TAG = "forged = session.channel.unauthentic(data, header, self._tally)"
FORGED = "        if forged:\n            return [forged]"
TAGS = "hmac.compare_digest(datagram[-TAG_BYTES:], key.tag(datagram[:-TAG_BYTES]))"
SIGNED_BY = "        return unauthentic(data, header, self.keys.receives if self.keys else None, statistics)"
ANY_BIT = (
    "any(hmac.compare_digest(datagram[-TAG_BYTES:], key.tag((int.from_bytes(datagram[:-TAG_BYTES], 'little') ^ bit)"
    ".to_bytes(len(datagram) - TAG_BYTES, 'little'))) for bit in (0, *(1 << n for n in range(320))))"
)

# fmt: off
PLAIN_ROWS = (
    ("does not look at the magic", (102,), (D, "if magic != MAGIC:", "if False:")),
    ("fills up short datagrams with zeros", (104,), (D, LENGTH, LENGTH.replace("!=", "<")),
     (D, "    if len(payload) != codec", "    payload = payload.ljust(codec.layout.size, b'\\0')\n    if len(payload) != codec")),
    ("leaves trailing bytes", (107,), (D, LENGTH, LENGTH.replace("!=", ">")),
     (D, "    size = len(datagram)\n", "    size = len(datagram)\n    if size >= HEADER_BYTES:\n"
      "        datagram = datagram[:HEADER_BYTES + int.from_bytes(datagram[10:12], 'little') + TRAILER_BYTES * (datagram[9] & 1)]\n"),
     (D, CRC, "if None and crc32(")),
    ("does not look at the CRC", (109, 111), (D, CRC, "if None and crc32(")),
    ("takes any major version", (112, 248), (D, "if major != VERSION_MAJOR:", "if False:")),
    ("ignores critical flags", (116,), (D, "if flags & CRITICAL_FLAGS & ~KNOWN_CRITICAL_FLAGS:", "if False:")),
    ("sends another minor version", (229,),
     (C, HEADER, HEADER.replace("self.minor", "self.minor if type(message).__name__ == 'Welcome' else 3"))),
    ("uses duplicates", (301,), DUPLICATE),
    ("uses late datagrams", (302,), (C, "return Arrival.LATE, 0", "return Arrival.NEW, 0")),
    ("follows any leap", (305,), (C, "if ahead > MAX_GAP_DATAGRAMS:", "if False:")),
    ("compares numbers as plain ones", (307, 308),
     (C, AHEAD, "ahead = sequence - self.newest if sequence >= self.newest else self._modulus // 2")),
    ("counts no losses", (310,), (C, "statistics.lost += skipped", "pass"),
     (C, "statistics.lost -= arrival is Arrival.LATE", "pass")),
    ("numbers from a byte", (894,), (C, NUMBER, "number = (self.next_sequence + 249) % 256")),
    ("echoes the number before", (312,), (C, "self._window.newest % SEQ", "max(self._window.newest - 1, 0) % SEQ")),
    ("uses stale datagrams", (313, 314), (C, "if max_age_ns is not None and age_ns > max_age_ns:", "if False:")),
    ("replies before it received", (317,),
     (S, STAMPS, "message._replace(received_ns=sent_ns + 1000, replied_ns=sent_ns)")),
    ("stamps in microseconds", (318,),
     (S, STAMPS, "message._replace(received_ns=message.received_ns // 1000, replied_ns=sent_ns // 1000)")),
    ("gives every session one number", (137,), (F, SESSION_NUMBER, "number = 7")),
    ("grants unasked", (136,), (F, GRANTED, "1")),
    ("grants everything", (136,), (F, GRANTED, "hello.capabilities")),
    ("opens for recorded HELLOs", (246,), (S, " or hello.client_nonce in self._past_nonces", "")),
    ("lets the newest client in", (211,), (S, OCCUPIED, "if False:")),
    ("uses a datagram of the session from anywhere", (218,), (S, SOURCE, "        if False:")),
    ("answers BYE", (222,),
     (S, "self._close(message.reason, now_ns, tell_peer=False)", "self._close(message.reason, now_ns, tell_peer=True)")),
    ("answers every stranger", (223,), (S, "if self._refused_at_ns is not None and", "if False and")),
    ("waits twice as long", (224,), (S, "now_ns - heard_ns <= self", "now_ns - heard_ns <= 2 * self")),
    ("leaves in silence", (224,), (S, "LINK_TIMEOUT, now_ns, tell_peer=True", "LINK_TIMEOUT, now_ns, tell_peer=False")),
    ("announces a longer timeout", (226,), (F, TIMEOUT, TIMEOUT.replace(",", " * 3 // 2,"))),
    ("sends STATE every cycle", (411,), (S, "period_ns = session.welcome.state_period_ms * NS_PER_MS", "period_ns = 0")),
    ("goes on unattended", (529,), (I, "return (*words, *stops), False", "return (*words, *stops), True"),
     (I, "return (*stops, *others), link_alive", "return (*stops, *others), True")),
    ("drops unknown commands", (432, 431), (S, "self.acknowledge(Acknowledgement(*request), now_ns)", "pass")),
    ("answers twice", (401,), (S, ANSWER, f"{ANSWER}\n{ANSWER}")),
    ("tells repetitions by the id alone", (433,), (L, "_pending[command_id] == content", "_pending[command_id] is not None"),
     (L, "if answered.content == content:", "if True:")),
    ("lets motions overtake", (434,), (L, "if command_id <= self._newest_id:", "if False:")),
    ("executes repetitions", (510,),
     (L, "        if command_id in self._pending:", "        self.__init__()\n        if command_id in self._pending:")),
    ("normalises anything", (441,),
     (D, POSE, POSE + "    norm = (qw * qw + qx * qx + qy * qy + qz * qz) ** 0.5\n    if 0.0 < norm < 9.0:\n"
      "        qw, qx, qy, qz = qw / norm, qx / norm, qy / norm, qz / norm\n")),
    ("drives the reachable part", (526,), (D, CONTENT, f"{CONTENT} if abs(numbers[at + 2]) < 10.0")),
    ("begins with HELLO", (231, 232, 237), (S, GREETED, GREETED.replace("[]", "self._confirmed(now_ns)"))),
    ("ends the old session at HELLO", (232, 233, 536),
     (S, GREETED, GREETED.replace("[]", "self.close(now_ns, Reason.PEER_RESTARTED)"))),
    ("lets the old session live on", (233,),
     (S, "if self._session:\n            events.append", "if False:\n            events.append"),
     (S, "self._session, self._unconfirmed = granted, None", "self._session, self._unconfirmed = granted, self._session")),
    ("keeps every grant", (234,),
     (S, "        self._unconfirmed = self._granted(",
      "        self._first = self._unconfirmed\n        self._unconfirmed = self._granted("),
     (S, "        sessions = (self._session, self._unconfirmed)\n",
      "        first = getattr(self, '_first', None)\n        if first and first.channel.session == number:\n"
      "            self._unconfirmed, self._first = first, None\n"
      "        sessions = (self._session, self._unconfirmed)\n")),
    ("grants for ever", (235,), (S, EXPIRED, "0 < 0")),
    ("grants for half the time", (235,), (S, EXPIRED, EXPIRED + " // 2")),
    ("begins with a heartbeat only", (236,),
     (S, f"        {USED}", "        if session is self._unconfirmed and not isinstance(message, Heartbeat):\n"
      f"            return [self._foreign('session.unknown', '')]\n        {USED}")),
    ("welcomes four times", (237,),
     (S, "        self._post(self._unconfirmed, self._unconfirmed.welcome, now_ns)",
      "        for _ in range(4):\n            self._post(self._unconfirmed, self._unconfirmed.welcome, now_ns)")),
    ("refuses others while a grant stands", (234,),
     (S, f"        {OCCUPIED}", f"        session = session or self._unconfirmed\n        {OCCUPIED}")),
    ("HELLO for another arm ends the session", (239,),
     (S, "return [self._foreign('session.wrong_arm'".replace("'", '"'), 'return [*self.close(now_ns), self._foreign("session.wrong_arm"')),
    ("another major version ends the session", (239,),
     (S, "self._refuse(Reason.INCOMPATIBLE_VERSION, 0, source, now_ns)",
      "self._refuse(Reason.INCOMPATIBLE_VERSION, 0, source, now_ns)\n                events += self.close(now_ns)")),
    ("sets a flag that no version has", (896,), (C, HEADER, HEADER.replace("flags", "flags | 2"))),
    ("is never silent", (228,),
     (S, "        if session is None or not self.state_due(now_ns):",
      "        self._last = session or getattr(self, '_last', None)\n        if session is None and self._last:\n"
      "            self._post(self._last, state, now_ns)\n        if session is None or not self.state_due(now_ns):")),
    ("forgets its answers", (402,), (L, "answered = self._answered.get(command_id)", "answered = None")),
    ("keeps its ledger over sessions", (408,), (F, "field(default_factory=CommandLedger)", "CommandLedger()")),
    ("judges the content first", (424,),
     (S, "        return [RequestReceived(request)]",
      "        if hasattr(request, 'X_BT_ref') and not request.X_BT_ref.is_finite():\n"
      "            self.acknowledge(Acknowledgement(request.command_id, Reason.NOT_FINITE, 0.0, 0.0), now_ns)\n"
      "            return []\n        return [RequestReceived(request)]")),
    ("announces another timeout each time", (135,), (F, TIMEOUT, TIMEOUT.replace(",", " + self.count,"))),
    ("counts its sessions", (137,), (F, SESSION_NUMBER, "number = 0x5A5A_0000_0000_0000 + self.count")),
    ("answers heartbeats by another clock", (138,),
     (S, STAMPS, "message._replace(received_ns=message.received_ns + 3_000_000, replied_ns=sent_ns + 3_000_000)")),
    ("stamps headers by another clock", (138,),
     (S, "channel.encoded(message, sent_ns)",
      "channel.encoded(message, sent_ns + 3_000_000 * (not isinstance(message, HeartbeatReply)))")),
    ("leaves long datagrams unchecked", (141, 142), (D, CRC, "if size <= 128 and checksum != crc32(")),
    ("answers heartbeats of any session", (241,),
     (S, "session = self._addressed(header.session)",
      "session = self._session if self._session and isinstance(message, Heartbeat) else self._addressed(header.session)")),
    ("answers heartbeats from any port", (241,), (S, SOURCE, SOURCE.replace(":", " and not isinstance(message, Heartbeat):"))),
    ("compares half the arm's hash", (242,),
     (S, "if hello.arm_hash not in (ANY_ARM, self._arm_hash):",
      "if hello.arm_hash and (hello.arm_hash ^ self._arm_hash) & 0xFFFFFFFF:")),
    ("wants BYE in order", (244,),
     (S, IS_BYE, IS_BYE.replace("            if", "            dropped = session.channel.hear(header, now_ns, 200_000_000, "
      "self._tally)\n            if dropped:\n                return [dropped]\n            if"))),
    ("remembers half the window", (320,), HALF_A_WINDOW),
    ("counts from when it reads", (326,), (C, "left_ns = now_ns - age_ns", "left_ns = now_ns")),
    ("numbers in 16 bits", (328,), (C, NUMBER, "number = self.next_sequence % 65_536")),
    ("answers twice after a restart", (401,),
     (S, "        self._session, self._unconfirmed = granted, None",
      "        self._again = bool(events)\n        self._session, self._unconfirmed = granted, None"),
     (S, ANSWER, f"{ANSWER}\n            if getattr(self, '_again', False):\n    {ANSWER}")),
    ("keeps 32 bits of an id", (434,),
     (L, "if command_id <= self._newest_id:", "if command_id & 0xFFFFFFFF <= self._newest_id & 0xFFFFFFFF:")),
    ("takes a subnormal for zero", (521,),
     (D, "numbers[at : at + 7]\n", "(0.0 if abs(each) < 1e-300 else each for each in numbers[at : at + 7])\n")),
    ("takes NaN for a default", (440,),
     (D, "numbers[-2], numbers[-1]", "*(0.0 if each != each else each for each in numbers[-2:])")),
    ("leaves odd waypoints out", (440,), (D, CONTENT, f"{CONTENT} if _pose(numbers, at).is_usable()")),
    ("judges stops in order of arrival", (415,), (I, "if is_stop(request):", "if False:"), REFERENCES_WAIT, ONE_A_SCAN),
    ("forgets the stop of a session that has ended", (423,), (I, "*(self._last_words or ()), *self._stops]", "*(self._last_words or ())]")),
    ("overtakes what comes after a stop", (424, 425),
     (I, "            commands = self._waiting\n",
      "            if self._stops:\n                return [overtaken(request.command_id, self._stops[-1].command_id)]\n"
      "            commands = self._waiting\n")),
    ("never overtakes", (425,), (I, "gone, self._waiting = [*repeated, *self._waiting], []", "gone = repeated")),
    ("counts one less over the wrap", (310,),
     (C, "return Arrival.NEW, ahead - 1", "return Arrival.NEW, max(ahead - 1 - (sequence < ahead), 0)")),
    ("takes none off over the wrap", (310,),
     (C, "return Arrival.LATE, 0", "return (Arrival.LATE if sequence <= self.newest else Arrival.DUPLICATE), 0")),
    ("ends by some reasons of BYE alone", (221,),
     (S, IS_BYE, IS_BYE.replace("isinstance(message, Bye)", "isinstance(message, Bye) and 30 < message.reason.value < 49"))),
    ("echoes the last one, late or not", (312,), (C, "self._window.newest % SEQ", "self._last % SEQ"),
     (C, "            arrival, skipped", "            self._last = header.sequence\n            arrival, skipped"),
     (C, "            self._window = SequenceWindow", "            self._last = header.sequence\n            self._window = SequenceWindow")),
    ("judges the rest after a stop", (416,),
     (I, "gone, self._waiting = [*repeated, *self._waiting], []", "gone = repeated"), REFERENCES_WAIT, ONE_A_SCAN),
    ("queues without bound", (417,),
     (I, "waiting[:-WAITING]], waiting[-WAITING:]", "waiting[:0]], waiting"), REFERENCES_WAIT),
    ("starts streams unasked", (541,),
     (S, NEGOTIATED, NEGOTIATED.replace(
         "if ", "if getattr(request, 'code', None) is not __import__('protocol.faults').faults.CommandCode.START_STREAM and "))),
    ("ends streams unasked", (541,),
     (S, NEGOTIATED, NEGOTIATED.replace(
         "if ", "if getattr(request, 'code', None) is not __import__('protocol.faults').faults.CommandCode.END_STREAM and "))),
    ("judges references unasked", (541,), (S, "if not session.welcome.capabilities & CAPABILITY_STREAMING:", "if False:")),
    ("does not look at the measurement's age", (584,), (S, "left_ns - before_sending_ns", "left_ns")),
    ("a motion survives a restart", (535, 538), (I, CLOSED, CLOSED.replace(":", " and event.reason.name != 'PEER_RESTARTED':"))),
    ("a motion survives BYE", (534, 537, 539),
     (I, CLOSED, CLOSED.replace(":", " and event.reason.name != 'SHUTDOWN':")), *LIVES_ON),
    ("compares padding", (419,), (S, "content_of(message)", "data[40:]")),
    ("falls back to the good reference", (426,),
     (I, "        gone: list[Request] = []", "        if hasattr(request, 'X_BT_ref') and abs(request.X_BT_ref.p_m[2]) > 100.0:\n"
      "            self._waiting.append(request)\n            return []\n        gone: list[Request] = []")),
    ("does not say what has overtaken", (426,),
     (I, "request.command_id) for each in gone", "request.command_id)._replace(value=0.0, limit=0.0) for each in gone"),
     (L, "overtaken(command_id, self._newest_id)", "overtaken(command_id, self._newest_id)._replace(value=0.0, limit=0.0)")),
    ("answers with the header's time", (422,), (S, "HeartbeatReply(message.sent_ns", "HeartbeatReply(header.sent_ns")),
)
KEYED_ROWS = (
    ("grants to who does not sign", (701,), (S, HELLO_TAG, f"{HELLO_TAG} if datagram.header.flags & 0x100 else None")),
    ("answers HELLO of any key", (702, 703), (S, HELLO_TAG, "forged = None")),
    ("takes any tag", (704,), (A, f"if not {TAGS}:", "if False:")),
    ("compares four bytes", (704,), (A, TAGS, TAGS.replace(":]", ":][:4]").replace("TAG_BYTES])", "TAG_BYTES])[:4]"))),
    ("lets any bit of the header change", (705,), (A, TAGS, ANY_BIT)),
    ("takes what is not signed", (706,), (A, 'return None if key is None else "authentication.missing"', "return None")),
    ("has one key for both ways", (707,),
     (C, SIGNED_BY, "        if self.keys and fault_of(data, header.flags, self.keys.sends) is None:\n"
      f"            return None\n{SIGNED_BY}")),
    ("takes the key of HELLO in a session", (708,),
     (S, TAG, TAG.replace("= ", "= None if unauthentic(data, header, self._key.of_hello(), LinkStatistics()) is None else "))),
    ("uses replays", (709,), DUPLICATE),
    ("leaves the upper half out", (711,),
     (C, "SequenceWindow(header.sequence, self._modulus)", "SequenceWindow(header.sequence % 2**32)"),
     (C, "self._window.arrive(header.sequence)", "self._window.arrive(header.sequence % 2**32)")),
    ("begins with anything", (713,),
     (S, f"        {TAG}", f"        if session is self._unconfirmed:\n            self._confirmed(now_ns)\n        {TAG}")),
    ("takes forgeries for life", (715,),
     (S, FORGED, FORGED.replace("return", "session.channel.heard_ns = now_ns\n            return"))),
    ("counts before it checks", (716,),
     (S, FORGED, FORGED.replace("return", "session.channel.hear(header, now_ns, None, LinkStatistics())\n            return"))),
    ("counts no forgeries", (717,),
     (C, "+ self.not_authenticated + self.key_not_configured + self.unknown_key + self.bad_tag\n", "\n")),
    ("signs sparingly", (718,), (C, "self.keys.sends if self.keys else", "self.keys.sends if self.keys and number % 40 else")),
    ("obeys unsigned BYEs", (719,),
     (S, TAG, TAG.replace("= ", "= None if isinstance(message, Bye) and not header.flags & 0x100 else "))),
    ("counts replays off the losses", (721,),
     (C, "statistics.lost -= arrival is Arrival.LATE", "statistics.lost -= header.sequence != self._window.newest")),
    ("has half a replay window", (723,), HALF_A_WINDOW),
    ("does not look at the key's id", (724,), (A, "if datagram[-TRAILER_BYTES:][4:8] !=", "if None and datagram[:0] !=")),
    ("looks at the key last", (725,),
     (S, "        if isinstance(datagram.message, Hello):\n",
      "        if isinstance(datagram.message, Hello) and self._session and self._session.source != source:\n"
      "            self._refuse(Reason.SESSION_OCCUPIED, 0, source, now_ns)\n            return []\n"
      "        if isinstance(datagram.message, Hello):\n")),
    ("forgeries move the age", (726,),
     (S, FORGED, FORGED.replace("return", "session.channel._age.age_ns(header.sent_ns, now_ns)\n            return"))),
    ("counts from the first heartbeat", (727,),
     (F, "channel.hear(header, now_ns, None, statistics)", "channel.hear(header, now_ns, None, statistics)\n        channel._window = None")),
    ("compares half the number", (728,),
     (C, "self._window.arrive(header.sequence)", "self._window.arrive(self._window.newest >> 32 << 32 | header.sequence & 0xFFFFFFFF)")),
    ("takes a length that counts the trailer", (729,),
     (D, f"    {LENGTH}", f"    payload_bytes -= after_payload * (payload_bytes == size - HEADER_BYTES)\n    {LENGTH}")),
    ("signs its hints", (730,),
     (S, "Channel(session, VERSION_MINOR, 0)",
      "Channel(session, VERSION_MINOR, 0, self._key and __import__('protocol.authentication').authentication.ChannelKeys("
      "self._key.of_hello(), self._key.of_hello()))")),
)
# fmt: on
_CLAUSES = {case.number: case.clause for case in reference_cases()}


def _rows(rows: tuple, key: bool) -> list[BrokenController]:  # type: ignore[type-arg]
    return [
        BrokenController(
            f"{name} ({case})", _CLAUSES[case], edited(*edits, key=key), KEY if key else None, case=case
        )
        for name, cases, *edits in rows
        for case in cases
    ]


MUTANTS = (*_rows(PLAIN_ROWS, False), *_rows(KEYED_ROWS, True))
