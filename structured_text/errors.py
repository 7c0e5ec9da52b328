"""What is refused of a text, and what a running program does wrong."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple, NoReturn

from protocol.errors import ConfigurationError

MOST_ERRORS = 20
"""So many are told at once."""

_FOLLOWS = "structured_text.follows"


class StructuredTextError(ConfigurationError):
    """Texts that are not compiled: a line ``file:line: reason`` an error; the cause ``structured_text.…``."""

    place: "Place"


class Place(NamedTuple):
    """Where something stands: the name of its file, and the line from 1 on."""

    file: str
    line: int

    def refuse(self, cause: str, reason: str) -> NoReturn:
        """Raise StructuredTextError for this place; ``cause`` without its prefix."""
        error = StructuredTextError(f"structured_text.{cause}", f"{self.file}:{self.line}: {reason}")
        error.place = self
        raise error

    def demand(self, holds: object, cause: str, reason: str) -> None:
        """Refuse unless ``holds``. Raises StructuredTextError."""
        if not holds:
            self.refuse(cause, reason)


class TextErrors:
    """All errors of the texts, so that one does not hide the next.

    ``lost``: names in capitals whose declaration is refused. That they are unknown later is no further error.
    """

    def __init__(self) -> None:
        self.errors: list[StructuredTextError] = []
        self.lost: set[str] = set()

    @contextmanager
    def kept(self, *names: str) -> Iterator[None]:
        """Go on behind the block with its error kept, and ``names`` lost."""
        try:
            yield
        except StructuredTextError as error:
            self.lost.update(map(str.upper, names))
            if error.cause != _FOLLOWS:
                self.errors.append(error)

    def unknown(self, place: Place, name: str, why: str, cause: str = "name") -> NoReturn:
        """Refuse ``name``, in silence if it is lost. Raises StructuredTextError."""
        place.refuse("follows" if name.upper() in self.lost else cause, f"{name} {why}")

    def tell(self) -> None:
        """Raise StructuredTextError with the first errors in the order of the texts, if there are any."""
        lines = {str(error): error for error in sorted(self.errors, key=lambda error: error.place)}
        shown = list(lines.values())[:MOST_ERRORS]
        if shown:
            raise StructuredTextError(shown[0].cause, "\n".join(map(str, shown)))


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
