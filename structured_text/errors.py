"""What is refused of a text, and what a running program does wrong."""

from typing import NamedTuple, NoReturn

from protocol.errors import ConfigurationError


class StructuredTextError(ConfigurationError):
    """A text that is not compiled; the message is ``file:line: reason``, the cause ``structured_text.…``."""


class Place(NamedTuple):
    """Where something stands: the name of its file, and the line from 1 on."""

    file: str
    line: int

    def refuse(self, cause: str, reason: str) -> NoReturn:
        """Raise StructuredTextError for this place; ``cause`` without its prefix."""
        raise StructuredTextError(f"structured_text.{cause}", f"{self.file}:{self.line}: {reason}")


class RuntimeFault(NamedTuple):
    """What a run-time check found first: ``reason`` in words, at ``place``. The call ended there."""

    place: Place
    reason: str

    def __str__(self) -> str:
        """``file:line: reason``."""
        return f"{self.place.file}:{self.place.line}: {self.reason}"


class ProgramFaulted(Exception):
    """A call that a run-time check ended; ``fault`` says where and why."""

    def __init__(self, fault: RuntimeFault) -> None:
        super().__init__(str(fault))
        self.fault = fault
