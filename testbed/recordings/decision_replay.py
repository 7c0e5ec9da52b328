"""The programs of a recording run again over its arm and eyes: does every one decide as it did then?

Time is what was recorded. A program gets the answers that it got then, in their order, whatever it makes of
them; each reference that it sends is compared with the recorded one, and its result at the end.
"""

import asyncio
from collections import Counter
from contextlib import suppress
from itertools import zip_longest
from typing import Any, cast

from foundation.recording.decoding import Values, decoder
from foundation.recording.mcap_file import Format
from nominal_arm.dimensions import boom_dimensions
from protocol.errors import LongreachError
from protocol.reference_messages import Command, Request, StreamedPose
from testbed.lockstep.clock import run
from testbed.recordings.comparison import OPERATION, REFERENCE, ReplayComparison
from testbed.recordings.recorded_vision import (
    AnsweredCall,
    BegunOperation,
    Ending,
    RecordedOperations,
    RecordedVision,
    SentReference,
    in_json,
)
from testbed.recordings.replayed_ports import (
    UNTIMED,
    LeavesReplay,
    NotRecorded,
    ReplayedArm,
    ReplayedCamera,
    ReplayedController,
    ReplayedEyes,
    SilentLog,
    Unrecorded,
)
from vision_pc.application.application import VisionApplication
from vision_pc.application.program import Program, by_name
from vision_pc.application.programs import PROGRAMS
from vision_pc.core.ports import Eyes
from vision_pc.shell.recording import read_messages as reads
from vision_pc.shell.recording import vision_messages as own

_NOTHING = "nothing more"


class ReplayedAnswers:
    """Implements ``AnswerSource``: takes them from ``operations`` in their order, and compares what is sent.

    ``commands``: how many commands others gave meanwhile, such as a stop.
    """

    def __init__(self, operations: RecordedOperations, comparison: ReplayComparison) -> None:
        self._operations = operations
        self._comparison = comparison
        self.taken = self.commands = 0
        self.operation = 0
        self.begun_ns = 0

    def begin(self, begun: BegunOperation) -> None:
        """Go on with the next operation."""
        self.taken, self.operation, self.begun_ns = 0, self.operation + 1, begun.log_ns

    def take(self, call: str, *sent: Request | StreamedPose) -> AnsweredCall:
        """As the protocol says."""
        answer = self._operations.next_call()
        if answer is None:
            self._nothing_more(call, sent)
            raise LeavesReplay
        self.taken += 1
        if answer.message.call != call:
            self.parted("asks for", answer.message.call, call, answer.log_ns)
            raise LeavesReplay
        error = reads.error_of_message(answer.message)
        quiet = error is not None or call in ("arm.halt", "stream.broken")
        self._compare(sent, answer.references, answer.log_ns, quiet)
        if error is not None:
            raise error
        return answer

    def parted(self, what: str, recorded: Any, replayed: Any, time_ns: int = 0) -> None:
        """Count the operation as one that came out otherwise."""
        self._comparison.different(
            OPERATION, self.operation, time_ns or self.begun_ns, what, recorded, replayed
        )

    def _nothing_more(self, call: str, sent: tuple[Request | StreamedPose, ...]) -> None:
        """The operation's answers are used up: it ended then, was cancelled, or the recording was cut off."""
        ending = self._operations.ending
        if ending is None:
            self._compare(sent, tuple(self._operations.unread), self.begun_ns, quiet=True)
        elif ending.state == "cancelled":
            raise asyncio.CancelledError
        elif self.taken == 0:
            raise NotRecorded(call)
        else:
            self.parted("asks for", _NOTHING, call)

    def _compare(
        self,
        sent: tuple[Request | StreamedPose, ...],
        recorded: tuple[SentReference, ...],
        log_ns: int,
        quiet: bool,
    ) -> None:
        """Compare what is sent with what was. ``quiet``: it may be that nothing was."""
        codes = {request.code.name for request in sent if isinstance(request, Command)}
        mine = [one for one in recorded if one.message.kind != "Command" or one.message.command in codes]
        self.commands += len(recorded) - len(mine)
        if quiet and not mine:
            return
        for request, one in zip_longest(sent, mine):
            if one is None:
                self._comparison.different(REFERENCE, 0, log_ns, "kind", None, type(request).__name__)
            elif request is None:
                told = (one.message.number, one.log_ns, "kind", one.message.kind, None)
                self._comparison.different(REFERENCE, *told)
            else:
                again = own.reference_bytes(one.message.number, _as_request(request, one.message))
                self._comparison.message(REFERENCE, one.message.number, one.message, again, one.log_ns)


class DecisionReplay:
    """Runs the programs of one recording again. ``not_run``: operations that could not be, by why.

    ``damages``: what of the file could not be read.
    """

    def __init__(
        self, recording: RecordedVision, programs: tuple[Program[Any, Any], ...] | None = None
    ) -> None:
        self.comparison = ReplayComparison(recording.exact)
        self.not_run: Counter[str] = Counter()
        self._operations = RecordedOperations(recording.path)
        self.damages = self._operations.damages
        self._answers = ReplayedAnswers(self._operations, self.comparison)
        self._programs = by_name(PROGRAMS if programs is None else programs)
        self._arm = ReplayedArm(self._answers)
        self._application = VisionApplication(
            self._arm,
            cast(Eyes, ReplayedEyes(self._answers, self._operations)),
            cast(Any, ReplayedController("controller")),
            cast(Any, ReplayedCamera(self._operations)),
            recording.config.programs,
            boom_dimensions(recording.arm),
            SilentLog(),
            cast(Any, Unrecorded("hand_eye")),
        )

    @property
    def commands(self) -> int:
        """How many commands others gave while programs ran; they are no decisions, and not compared."""
        return self._answers.commands

    def run(self) -> ReplayComparison:
        """Run all of them, in their order."""
        while (begun := self._operations.next_operation()) is not None:
            self._answers.begin(begun)
            if begun.kind not in self._programs:
                self.not_run[f"{begun.kind}: no program of this version"] += 1
                continue
            try:
                ending = self._ending(begun)
            except NotRecorded as asked:
                self.not_run[f"{begun.kind}: {asked} is not recorded"] += 1
            except LeavesReplay:
                continue  # where it parted has been told, or the recording ends
            else:
                self._note_end(ending)
        return self.comparison

    def _ending(self, begun: BegunOperation) -> Ending:
        """How the program ends now; whatever ends it early stops the arm, as behind the API."""
        program = self._programs[begun.kind]
        try:
            settings = program.requested(self._application, program.body(**begun.body))
            result: Any = run(program.run(self._application, settings, _unheard))
        except asyncio.CancelledError:
            ending = Ending("cancelled", None, None)
        except LongreachError as error:
            ending = Ending("failed", None, error.cause)
        except Exception:
            ending = Ending("failed", None, "internal")
        else:
            return Ending("succeeded", program.to_json(result), None)
        if self._operations.peek() is not None:
            with suppress(LongreachError):  # then too the arm could not be reached
                run(self._arm.halt())
        return ending

    def _note_end(self, ending: Ending) -> None:
        left = self._operations.next_call()
        recorded = self._operations.ending
        if left is not None:
            self._answers.parted("asks for", left.message.call, _NOTHING, left.log_ns)
        elif recorded is None:
            self.not_run["cut off before its end"] += 1
        else:
            values = [_flat(each) for each in (recorded, ending)]
            self.comparison.values(OPERATION, self._answers.operation, self._answers.begun_ns, *values)


def _flat(ending: Ending) -> Values:
    decode = decoder(Format("", "", b"", "json"))
    assert decode is not None
    return decode(in_json(ending))


def _as_request(request: Request | StreamedPose, recorded: Any) -> Request | StreamedPose:
    if isinstance(request, StreamedPose) and request.time_ns == UNTIMED:
        return request._replace(time_ns=recorded.measured_ns)
    return request


def _unheard(progress: float, note: str) -> None:
    """A report that nobody reads."""
