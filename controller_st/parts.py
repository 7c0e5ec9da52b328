"""The compiled program in the places of the controller's own scan and sessions, in shell and lockstep."""

import hashlib
import itertools
import math
import struct
from collections.abc import Callable, Iterable
from ipaddress import IPv4Address

from controller.config import ControllerConfig
from controller.core.group_states import LIVE
from controller.core.scan_program import ScanProgram
from controller.core.scan_types import ControllerView, ScanEvent, ScanInput, ScanOutput, ScanState
from controller.core.supervision import Fault
from controller_st.program import TextController
from foundation.configuration import configuration_hash
from nominal_arm.description import NominalArm
from protocol.authentication import LinkKey
from protocol.axes_group import Mode
from protocol.channel import LinkStatistics
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.process_image import SensorImage, ValveImage, encode_sensors
from protocol.reference_messages import Acknowledgement, Command, State, StreamRefused
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent, SessionClosed, SessionOpened
from protocol.session_factory import Source
from structured_text.memory import MemoryView

_STATE = struct.Struct(
    "<QQHHHHQII18d14dd8I"
)  # ST_LR_State behind its header, as STATE lies in a datagram (1.2)
_HEADER_BYTES = 40
_OTHER = 1  # the number of a peer that is no address


class TextProgram(ScanProgram):
    """The scan of ``text``; the sessions of the same program are a TextServer's.

    ``after_scan`` is called with the scan's time when the program's memory is at rest.
    """

    def __init__(self, arm: NominalArm, config: ControllerConfig, text: TextController) -> None:
        super().__init__(arm, config)
        self._text = text
        self.after_scan: Callable[[int], None] = lambda now_ns: None
        self._mode, self._fault = Mode.DISABLED, FaultCode.NONE

    @property
    def memory(self) -> MemoryView:
        """All variables of the program."""
        return self._text.memory

    @property
    def state(self) -> ScanState:
        """What the shell asks of the scan's state: cycle, mode and fault; the rest is at its beginning."""
        arm = self._text.arm
        fault = Fault(FaultCode(arm.eFault), arm.fFaultValue, arm.fFaultLimit)
        return self._state._replace(cycle=arm.nCycle, mode=Mode(arm.eMode), fault=fault)

    def scan(self, inputs: ScanInput) -> ScanOutput:
        """What one scan of ``inputs`` puts out; requests and answers pass through the server alone."""
        sensors = inputs.sensors
        words = encode_sensors(sensors) if isinstance(sensors, SensorImage) else sensors
        leaves = any(isinstance(r, Command) and r == (0, CommandCode.DISABLE) for r in inputs.requests)
        fault = self._text.step(inputs.now_ns, inputs.sensed_ns, inputs.dt_s, words, leaves=leaves)
        view, mode = self._view(), Mode(self._text.arm.eMode)
        events = []
        if fault is not None:
            events.append(ScanEvent("fault", f"NUMERIC: {fault}", math.nan, 0.0))
        elif view.fault is not self._fault and view.fault is not FaultCode.NONE:
            arm = self._text.arm
            events.append(ScanEvent("fault", view.fault.name, arm.fFaultValue, arm.fFaultLimit))
        if mode is not self._mode:
            events.append(ScanEvent("mode", f"{self._mode.name} -> {mode.name}", 0.0, 0.0))
        self._mode, self._fault = mode, view.fault
        self.after_scan(inputs.now_ns)
        cycle, control, *spools = self._text.valve_words[:8]
        a, b, c, d, e, f = ((word - 0x10000 if word > 0x7FFF else word) / 0x7FFF for word in spools)
        return ScanOutput(ValveImage(cycle, control, (a, b, c, d, e, f)), (), None, view, tuple(events))

    def _view(self) -> ControllerView:
        time_ns, cycle, group, fault, severity, flags, motion, done, segment, *rest = _STATE.unpack_from(
            self._text.state, _HEADER_BYTES
        )
        six = [tuple(rest[at : at + 6]) for at in (0, 6, 12)]
        live = Mode(self._text.arm.eMode) in LIVE
        X_BT, X_BT_cmd = (Pose(tuple(rest[at : at + 3]), tuple(rest[at + 3 : at + 7])) for at in (18, 25))
        states = GroupState(group), FaultCode(fault), Severity(severity)
        return ControllerView(
            time_ns, cycle, *states, flags, motion, bool(done), segment, six[0], six[1], six[2],
            X_BT, X_BT_cmd if live else X_BT, rest[32], rest[39], rest[40],
        )  # fmt: skip


class TextServer(ReferenceServer):
    """The sessions of ``text``. What a shell hands back of a scan is in the program already, and is left."""

    def __init__(self, arm: NominalArm, config: ControllerConfig, text: TextController) -> None:
        cycle_ns = round(1e6 * config.cycle_ms)
        super().__init__(1, configuration_hash(arm), cycle_ns, config.reference_link.link_timeout_ms)
        self._text = text
        self._known: int | None = None
        self._other: Source = None

    @property
    def statistics(self) -> LinkStatistics:
        """What the program counts."""
        lost, dropped = self._text.losses
        return LinkStatistics(lost=lost, refused=dropped)

    @property
    def session(self) -> int | None:
        """Number of the open session."""
        return self._text.session or None

    def link_alive(self, now_ns: int) -> bool:
        """Whether a peer is connected."""
        return self.session is not None

    def tick(self, now_ns: int) -> list[ServerEvent]:
        """What has become of the session since the last call."""
        open_now = self.session
        if open_now == self._known:
            return []
        before, self._known = self._known, open_now
        events: list[ServerEvent] = []
        if before is not None:
            events.append(SessionClosed(before, Reason(self._text.ended_by)))
        if open_now is not None:
            events.append(SessionOpened(open_now, self._source(self._text.peer)))
        return events

    def receive_batch(self, datagrams: Iterable[tuple[bytes, Source]], now_ns: int) -> list[ServerEvent]:
        """Have the program take in what was waiting in the socket at ``now_ns``."""
        came = [(data, self._number(source)) for data, source in datagrams]
        if came:
            self._text.take(came, now_ns)
        return self.tick(now_ns)

    def receive(self, data: bytes, source: Source, now_ns: int) -> list[ServerEvent]:
        """The same for one."""
        return self.receive_batch([(data, source)], now_ns)

    def outgoing(self, now_ns: int | None = None) -> list[tuple[bytes, Source]]:
        """Datagrams to be sent now, in order, and where to."""
        return [(data, self._source(peer)) for data, peer in self._text.outgoing()]

    def state_due(self, now_ns: int) -> bool:
        """Always: the program is to know the shell's figures, and keeps the period itself."""
        return True

    def publish(self, state: State, now_ns: int) -> None:
        """Leave the shell's figures of ``state`` for the next STATE."""
        self._text.note(state.overruns, state.lateness_p50_us, state.lateness_p99_us, state.lateness_max_us)

    def acknowledge(self, acknowledgement: Acknowledgement, now_ns: int) -> None:
        """Nothing: the program has answered."""

    def refuse_streamed(self, refusal: StreamRefused, now_ns: int) -> None:
        """Nothing: the program has answered."""

    def close(self, now_ns: int, reason: Reason = Reason.SHUTDOWN) -> list[ServerEvent]:
        """Ends the session, if there is one, with BYE SHUTDOWN."""
        self._text.goodbye(now_ns)
        return self.tick(now_ns)

    def _number(self, source: Source) -> int:
        if isinstance(source, tuple):
            host, port = source
            return int(IPv4Address(host)) << 16 | int(port)
        self._other = source
        return _OTHER

    def _source(self, peer: int) -> Source:
        return self._other if peer == _OTHER else (str(IPv4Address(peer >> 16)), peer & 0xFFFF)


def text_parts(
    arm: NominalArm, config: ControllerConfig, boot_id: int, key: LinkKey | None
) -> tuple[TextProgram, ReferenceServer]:
    """Scan and sessions of one program, in the place of ``own_parts``.

    Session numbers are drawn from what ``boot_id`` holds above the 64 bits that WELCOME tells, so that a
    rerun repeats them and nobody can compute them. Raises ConfigurationError as TextController does.
    """
    assert key is None  # ``constants`` refuses a configuration with one
    secret, drawn = boot_id.to_bytes(32, "little"), itertools.count()

    def draw() -> int:
        made = hashlib.blake2b(next(drawn).to_bytes(8, "little"), digest_size=8, key=secret).digest()
        return int.from_bytes(made, "little") or 1

    text = TextController(arm, config, boot_id % 2**64 or 1, draw)
    return TextProgram(arm, config, text), TextServer(arm, config, text)
