"""The one mutator of the conformance suites: a controller is broken in a hook or in a place of its source.

Every table of broken controllers is made of ``hooked`` and ``edited``.
"""

import importlib
import sys
from collections.abc import Callable, Mapping
from functools import cache, partial
from types import ModuleType
from typing import Any, NamedTuple
from unittest.mock import patch

from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.inbox import Inbox
from protocol.authentication import LinkKey
from protocol.axes_group import Mode, Transition
from protocol.datagram import decode, encode
from protocol.faults import CommandCode
from protocol.reference_messages import Command, Request
from protocol.server_session import ReferenceServer
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest, shipped_arm_hash
from tests.support.paths import ROOT

KEY = LinkKey(bytes(range(32)))
# In the order in which they need one another.
MODULES = {
    "authentication": "protocol.authentication", "datagram": "protocol.datagram",
    "channel": "protocol.channel", "ledger": "protocol.command_ledger", "factory": "protocol.session_factory",
    "server": "protocol.server_session", "inbox": "controller.core.inbox",
}  # fmt: skip
Make = Callable[[], ControllerUnderTest]
# Module, what stands there, and what stands there instead.
Edit = tuple[str, str, str]


class BrokenController(NamedTuple):
    """A controller that breaks one clause; ``case`` must catch it."""

    name: str
    clause: str
    make: Make
    key: LinkKey | None = None
    case: int = 0


class KeyedController(ControllerUnderTest):
    """A sound controller that has a key."""

    link_key: LinkKey = KEY


def hooked(**members: Any) -> Make:
    """Makes controllers of which these methods or attributes are other ones."""
    return lambda: type("Hooked", (ControllerUnderTest,), members)()


def takes(kind: type, other: Callable[[Any], Any]) -> Make:
    """Makes controllers that take requests of a kind for other ones."""
    return hooked(judge=lambda _, request: other(request) if isinstance(request, kind) else request)


def follows(other: Callable[[Any, Any], dict[str, Any]]) -> Make:
    """Makes controllers that take streamed references otherwise, in an open stream.

    ``other`` gets the message and the stream, and gives the fields that are other ones.
    """

    def judge_streamed(self: Any, arrival: Any) -> Any:
        stream = self.bench.state.stream
        changed = {} if stream is None else other(arrival.message, stream)
        return arrival._replace(message=arrival.message._replace(**changed))

    return hooked(judge_streamed=judge_streamed)


def with_cell(cell: tuple[Mode, Stimulus], step: Transition) -> Make:
    """Makes controllers whose table of states is another one in one cell."""

    def scan(self: Any) -> None:
        with patch.dict(TRANSITIONS, {cell: step}):
            ControllerUnderTest._scan(self)

    return hooked(_scan=scan)


def edited(*edits: Edit, key: bool = False) -> Make:
    """Makes controllers whose code of the link is a copy of ours in which ``edits`` are made."""
    return partial(_Copied, edits, key)


class _Copied(ControllerUnderTest):
    def __init__(self, edits: tuple[Edit, ...], key: bool) -> None:
        copied = copies(MODULES, edits)
        self._server_class: Any = copied["server"].ReferenceServer
        self._inbox_class: Any = copied["inbox"].Inbox
        # The key, too, is made by the changed copy.
        self.link_key = copied["authentication"].LinkKey(bytes(range(32))) if key else None
        super().__init__()

    def make_server(self) -> ReferenceServer:
        return self._server_class(77, shipped_arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, key=self.link_key)

    def make_inbox(self) -> Inbox:
        return self._inbox_class()


@cache
def _source(module: str) -> str:
    return ROOT.joinpath(*module.split(".")).with_suffix(".py").read_text()


def copies(modules: Mapping[str, str], edits: tuple[Edit, ...]) -> dict[str, ModuleType]:
    """Copies of ``modules``, in the order in which they need one another, in which ``edits`` are made."""
    originals = {name: importlib.import_module(name) for name in modules.values()}
    copied: dict[str, ModuleType] = {}
    try:
        for short, name in modules.items():
            text = _source(name)
            for _, old, new in (edit for edit in edits if edit[0] == short):
                assert old in text, f"{name} has no {old!r}"
                text = text.replace(old, new)
            sys.modules[name] = copied[short] = ModuleType(name)
            exec(compile(text, name, "exec"), copied[short].__dict__)
    finally:
        sys.modules.update(originals)
    return copied


def reworked(data: bytes, kind: type, rework: Callable[[Any], Any]) -> bytes:
    """``data`` with its message replaced by ``rework(message)`` if it is of ``kind``."""
    header, message = decode(data)
    return encode(rework(message), header) if isinstance(message, kind) else data


def says(code: CommandCode, request: Request) -> bool:
    """Whether ``request`` is the command ``code``."""
    return isinstance(request, Command) and request.code is code
