"""The compiled controller behind a pure face: datagrams, words and times in; datagrams and words out."""

import ctypes
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from controller.config import ControllerConfig
from controller.core.plant_watch import PlantRefusal
from controller_st.constants import constants_text, refuse_edited
from nominal_arm.description import NominalArm
from structured_text.errors import ProgramFaulted, RuntimeFault
from structured_text.program import CompiledProgram

_PROGRAM, _MOST = "PRG_LR_Controller", 64
_SHIPPED = Path(__file__).parent / "plc"
_CHECKOUT = Path(__file__).parents[1]
Datagram = tuple[bytes, int]
"""Its bytes, and a number that tells its peer from others, not 0."""


def texts(arm: NominalArm, config: ControllerConfig) -> dict[str, str]:
    """The program's texts by file name, with the constants of this configuration.

    Raises ConfigurationError for what the program does not have, and for texts that cannot be read.
    """
    folders = [_SHIPPED] if _SHIPPED.is_dir() else [_CHECKOUT / "docs" / "protocol", _CHECKOUT / "plc"]
    found = {p.name: p.read_text(encoding="utf-8") for f in folders for p in sorted(f.glob("*.st"))}
    if "constants.st" in found:
        refuse_edited(found["constants.st"])
    return found | {"constants.st": constants_text(arm, config)}


class TextController:
    """The program with its memory. ``draw``: a new random number, not 0, not to be computed (4.2).

    ``memory`` is the program's own, ``arm`` its view of the group, ``state`` the bytes of ST_LR_State. Times
    are of the controller's monotonic clock. ``faults``: what run-time checks have found, newest last.
    """

    def __init__(
        self, arm: NominalArm, config: ControllerConfig, boot_id: int, draw: Callable[[], int]
    ) -> None:
        """Raises ConfigurationError, and StructuredTextError for a text that is not of the language."""
        self._program = CompiledProgram(texts(arm, config))
        self._draw = draw
        self.memory = self._program.memory
        self._in = self.memory.PRG_LR_Controller
        self._in.nBootId = boot_id
        self.arm, self.state = self._in.stArm, self._in.stState.data
        self._link = self._in.stLink
        self._received = [_Packet(each) for each in self.memory.aLR_Received]
        self._sent = [_Packet(each) for each in self._link.aSent]
        self._words = self.memory.aLR_Inputs.numbers
        self._valves = self.memory.aLR_Outputs.numbers
        self._out: list[Datagram] = []
        self.faults: deque[RuntimeFault] = deque(maxlen=16)

    @property
    def valve_words(self) -> list[int]:
        """The words for the plant (12)."""
        return self._valves.tolist()  # type: ignore[no-any-return]

    @property
    def session(self) -> int:
        """Number of the open session, 0 for none."""
        return self._link.stOpen.nNumber  # type: ignore[no-any-return]

    @property
    def peer(self) -> int:
        """The number of its peer."""
        return self._link.stOpen.nPeer  # type: ignore[no-any-return]

    @property
    def ended_by(self) -> int:
        """The reason of the last session's end."""
        return self._link.eEnded  # type: ignore[no-any-return]

    @property
    def losses(self) -> tuple[int, int]:
        """Datagrams that never came, and that came and were not used."""
        return self._link.nLost, self._link.nDropped

    def outgoing(self) -> list[Datagram]:
        """The datagrams to send since the last call, in order."""
        sent, self._out = self._out, []
        return sent

    def note(self, overruns: int, p50_us: int, p99_us: int, max_us: int) -> None:
        """Figures of the shell for the next STATE; lateness of the scan in microseconds."""
        self._in.nOverruns, self._in.nLatenessMax_us = overruns % 2**32, min(max_us, 2**32 - 1)
        self._in.nLatenessP50_us, self._in.nLatenessP99_us = p50_us, p99_us

    def take(self, datagrams: list[Datagram], now_ns: int) -> None:
        """Take in datagrams between two scans; the answers are in ``outgoing``."""
        self._in.xScan = False
        for at in range(0, len(datagrams), _MOST):
            self._run(datagrams[at : at + _MOST], now_ns)

    def goodbye(self, now_ns: int) -> None:
        """End the session, if there is one, with BYE SHUTDOWN."""
        self._in.xScan, self._in.xGoodbye = False, True
        self._run([], now_ns)
        self._in.xGoodbye = False

    def step(
        self,
        now_ns: int,
        sensed_ns: int,
        dt_s: float,
        words: Sequence[int] | PlantRefusal | None,
        *,
        leaves: bool = False,
    ) -> RuntimeFault | None:
        """One scan. ``words``: of the plant at ``sensed_ns``; None when it did not answer.

        ``leaves``: ramp down and drop the enable. After the fault of a run-time check, which is returned, the
        scan is run once more to stop the arm: NUMERIC, valves off.
        """
        given = self._in
        given.nSensed_ns, given.fDt, given.xShutdown = sensed_ns, dt_s, leaves
        given.xPlant, given.nRefusal = False, 0
        if isinstance(words, PlantRefusal):
            given.nRefusal = words.code
        elif words is not None:
            given.xPlant = True
            self._words[:] = words
        given.xScan = True
        fault = self._run([], now_ns)
        if fault is not None:
            given.xRuntimeFault = True
            if self._run([], now_ns) is not None:  # not even that: all words zero is a valid image (10.5)
                self._valves[:] = 0
            given.xRuntimeFault = False
        return fault

    def _run(self, datagrams: list[Datagram], now_ns: int) -> RuntimeFault | None:
        for place, (data, peer) in zip(self._received, datagrams, strict=False):
            place.put(data, peer, self._draw())
        self._in.nNow_ns, self._in.nReceived = now_ns, len(datagrams)
        try:
            self._program.run(_PROGRAM)
        except ProgramFaulted as error:
            self.faults.append(error.fault)
            return error.fault
        self._out += [self._sent[k].datagram() for k in range(self._link.nSent)]
        return None


class _Packet:
    """An ST_LR_Packet in memory."""

    def __init__(self, view: Any) -> None:
        self._view, fields = view, view.type.fields
        self._data = view.aData.data
        number, size = ctypes.c_uint64, ctypes.c_uint16
        self._peer = number.from_address(view.address + fields["NPEER"].offset)
        self._random = number.from_address(view.address + fields["NRANDOM"].offset)
        self._bytes = size.from_address(view.address + fields["NBYTES"].offset)

    def put(self, data: bytes, peer: int, drawn: int) -> None:
        """Leave a datagram; of one that is too long, what tells that it is."""
        stored = data[: len(self._data)]
        self._data[: len(stored)] = stored
        self._peer.value, self._random.value = peer, drawn
        self._bytes.value = min(len(data), 0xFFFF)

    def datagram(self) -> Datagram:
        """The datagram and its peer."""
        return bytes(self._data[: self._bytes.value]), self._peer.value
