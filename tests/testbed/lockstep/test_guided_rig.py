"""After a fault the guided rig does what an operator does, and no more than that."""

from types import SimpleNamespace
from typing import cast

import pytest

from protocol.errors import RequestRefused
from protocol.faults import CommandCode
from testbed.lockstep.rig import GuidedRig, recover


class RampingLink:
    """Refuses RESET ``ramping`` times for ``cause``."""

    def __init__(self, ramping: int, cause: str) -> None:
        self.left = ramping
        self.cause = cause
        self.accepted: list[CommandCode] = []

    def command(self, code: CommandCode) -> None:
        """Accepts, or raises RequestRefused."""
        if code is CommandCode.RESET and self.left > 0:
            raise RequestRefused(self.cause, "not yet")
        self.accepted.append(code)

    def next_state(self) -> None:
        """A scan later."""
        self.left -= 1


def rig(link: RampingLink) -> GuidedRig:
    return cast(GuidedRig, SimpleNamespace(link=link, run=lambda answer: answer))


def test_reset_is_asked_again_while_the_arm_ramps_down() -> None:
    link = RampingLink(3, "refused.stopping")
    recover(rig(link))
    assert link.accepted == [CommandCode.RESET, CommandCode.ENABLE]


def test_another_refusal_is_not_asked_away() -> None:
    link = RampingLink(3, "refused.latched")
    with pytest.raises(RequestRefused):
        recover(rig(link))
    assert link.accepted == []
    assert link.left == 3
