"""Of every two commands of one scan the second, or the first, is lost, answered as if alone, or they swap."""

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

from controller.core.inbox import Inbox
from protocol.axes_group import ANSWERS, Asked, Mode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import Command, Request
from tests.conformance.mutator import BrokenController, Make, hooked

_CODES = (
    CommandCode.ENABLE,
    CommandCode.DISABLE,
    CommandCode.STOP,
    CommandCode.RESET,
    CommandCode.EMERGENCY_STOP,
    CommandCode.EMERGENCY_RELEASE,
)
_STOPS = (CommandCode.DISABLE, CommandCode.STOP, CommandCode.EMERGENCY_STOP)
Pair = tuple[CommandCode, CommandCode]


def _scans_with(pair: Pair, bend: Callable[[Any, Any], tuple[Request, ...]]) -> Make:
    class Bent(Inbox):
        def take(self, link_alive: bool) -> tuple[tuple[Request, ...], bool]:
            taken, alive = super().take(link_alive)
            codes = tuple(each.code for each in taken if isinstance(each, Command))
            return (bend(*taken) if len(taken) == 2 and codes == pair else taken), alive

    return hooked(make_inbox=lambda _: Bent())


def _answers(*codes: CommandCode) -> list[tuple[Reason, ...]]:
    """What a sound controller answers to ``codes`` one after the other, in each mode at rest."""
    answers = []
    for mode in (Mode.DISABLED, Mode.STANDBY, Mode.ERROR_HELD, Mode.EMERGENCY):
        reasons = []
        for code in codes:
            step = ANSWERS[mode, Asked(code)]
            mode = step.mode
            reasons.append(step.reason)
        answers.append(tuple(reasons))
    return answers


def _pairs() -> Iterator[BrokenController]:
    for first, second in product(_CODES, repeat=2):
        if second in _STOPS and first not in _STOPS:
            continue  # the stop overtakes: they are never of one scan
        case = 424 if CommandCode.ENABLE not in (first, second) else 426
        sound = _answers(first, second)
        swapped = [answers[::-1] for answers in _answers(second, first)]
        broken: list[tuple[str, Any, bool]] = [
            ("the second is lost", lambda one, other: (one,), False),
            ("the first is lost", lambda one, other: (other,), False),
        ]
        if first is not second:
            alike = _answers(first, first) == sound
            broken += [
                ("the second is taken for the first", lambda a, b: (a, b._replace(code=a.code)), alike),
                ("they swap", lambda one, other: (other, one), swapped == sound),
            ]
        for say, bend, unseen in broken:
            name = f"{first.name}, {second.name} in one scan: {say}"
            why = "no mode at rest answers otherwise" if unseen else ""
            yield BrokenController(name, "6.13", _scans_with((first, second), bend), unseen=why, case=case)


MUTANTS = tuple(_pairs())
