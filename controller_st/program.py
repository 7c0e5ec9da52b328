"""The compiled controller behind a pure face: datagrams, the plant's words and times in; datagrams and words out."""

import ctypes
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from controller.config import ControllerConfig
from controller.core.plant_watch import PlantRefusal
from controller_st.constants import constants_text
from nominal_arm.description import NominalArm
from structured_text.errors import ProgramFaulted, RuntimeFault
from structured_text.program import Program

_PROGRAM, _MOST = "PRG_LR_Controller", 64
_SHIPPED = Path(__file__).parent / "plc"
_CHECKOUT = Path(__file__).parents[1]
Datagram = tuple[bytes, int]
"""Its bytes, and a number that tells its peer from others, not 0."""


class Scanned(NamedTuple):
    """What one scan leaves: words for the plant, datagrams to send, the fault that a run-time check found."""

    valve_words: list[int]
    sent: list[Datagram]
    fault: RuntimeFault | None


def texts(arm: NominalArm, config: ControllerConfig) -> dict[str, str]:
    """The program's texts by file name, with the constants of this configuration.

    Raises ConfigurationError for what the program does not have, and for texts that cannot be read.
    """
    folders = [_SHIPPED] if _SHIPPED.is_dir() else [_CHECKOUT / "docs" / "protocol", _CHECKOUT / "plc"]
    found = {p.name: p.read_text(encoding="utf-8") for f in folders for p in sorted(f.glob("*.st"))}
    return found | {"constants.st": constants_text(arm, config)}


class TextController:
    """The program with its memory. ``draw``: a new random number, not 0, not to be computed (4.2).

    ``memory`` is the program's own, ``arm`` its view of the group; times are of the controller's monotonic clock.
    """

    def __init__(
        self, arm: NominalArm, config: ControllerConfig, boot_id: int, draw: Callable[[], int]
    ) -> None:
        """Raises ConfigurationError; StructuredTextError for a text that is not of the language."""
        self._program = Program(texts(arm, config))
        self._draw = draw
        self.memory = self._program.memory
        self.inputs = self.memory.PRG_LR_Controller
        self.inputs.nBootId = boot_id
        self.arm = self.inputs.stArm
        self._link = self.inputs.stLink
        self._received = [_Packet(each) for each in self.memory.aLR_Received]
        self._sent = [_Packet(each) for each in self._link.aSent]
        self._words = self.memory.aLR_Inputs.numbers
        self._valves = self.memory.aLR_Outputs.numbers

    def receive(self, datagrams: Iterable[Datagram], now_ns: int) -> list[Datagram]:
        """Take in datagrams between two scans; what is answered at once."""
        self.inputs.xScan = False
        return self._take(list(datagrams), now_ns)[0]

    def scan(
        self,
        now_ns: int,
        sensed_ns: int,
        dt_s: float,
        words: Sequence[int] | PlantRefusal | None,
        datagrams: Iterable[Datagram] = (),
    ) -> Scanned:
        """One scan. ``words``: of the plant at ``sensed_ns``; None when it did not answer.

        After a fault of a run-time check the scan is run once more to stop the arm: NUMERIC, valves off.
        """
        inputs = self.inputs
        inputs.nSensed_ns, inputs.fDt = sensed_ns, dt_s
        inputs.xPlant = words is not None and not isinstance(words, PlantRefusal)
        inputs.nRefusal = words.code if isinstance(words, PlantRefusal) else 0
        if inputs.xPlant:
            self._words[:] = words
        waiting = list(datagrams)
        inputs.xScan = False
        early, fault = self._take(waiting[:-_MOST], now_ns) if len(waiting) > _MOST else ([], None)
        inputs.xScan = True
        sent, late = self._take(waiting[-_MOST:], now_ns)
        fault = fault or late
        if fault is not None:
            inputs.xRuntimeFault = True
            sent, again = self._take([], now_ns)
            inputs.xRuntimeFault = False
            if again is not None:
                self._valves[:] = 0
        return Scanned(self._valves.tolist(), early + sent, fault)

    def _take(self, datagrams: list[Datagram], now_ns: int) -> tuple[list[Datagram], RuntimeFault | None]:
        self.inputs.nNow_ns = now_ns
        sent: list[Datagram] = []
        for at in range(0, max(len(datagrams), 1), _MOST):
            part = datagrams[at : at + _MOST]
            for place, (data, peer) in zip(self._received, part, strict=False):
                place.put(data, peer, self._draw())
            self.inputs.nReceived = len(part)
            try:
                self._program.run(_PROGRAM)
            except ProgramFaulted as error:
                return sent, error.fault
            sent += [self._sent[k].datagram() for k in range(self._link.nSent)]
        return sent, None


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
        kept = data[: len(self._data)]
        self._data[: len(kept)] = kept
        self._peer.value, self._random.value = peer, drawn
        self._bytes.value = min(len(data), 0xFFFF)

    def datagram(self) -> Datagram:
        """The datagram and its peer."""
        return bytes(self._data[: self._bytes.value]), self._peer.value
