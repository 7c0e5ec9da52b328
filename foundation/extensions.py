"""What installed packages add, by entry points: found, loaded and judged one by one.

One that is broken, or whose name is taken, is left out and told with its cause; the others go on working.
"""

from collections.abc import Callable, Collection, Iterator
from importlib.metadata import entry_points
from typing import Any, Generic, NamedTuple, TypeVar

from protocol.errors import ConfigurationError

T = TypeVar("T")


class Declared(NamedTuple):
    """An entry point before it is loaded; ``taken``: why its name is not its own, else empty."""

    name: str
    place: str
    package: str
    taken: str = ""


class LeftOut(NamedTuple):
    """An entry point that is not used: ``extension.not_loaded``, ``.wrong_type`` or ``.name_taken``."""

    declared: Declared
    cause: str
    why: str

    def __str__(self) -> str:
        return f"{self.cause}: {self.declared.name} of {self.declared.package}: {self.why}"


class Extensions(NamedTuple, Generic[T]):
    """Those that can be used, by name, with their packages; and those that were left out."""

    found: dict[str, T]
    packages: dict[str, str]
    left_out: tuple[LeftOut, ...]

    def why_not(self, name: str) -> str:
        """Why nothing of this name can be used, for the end of a refusal; empty where none is declared."""
        return "".join(f"; {one}" for one in self.left_out if one.declared.name == name)


def declared(group: str, ours: Collection[str]) -> list[Declared]:
    """The entry points of ``group``, by name; nothing is loaded. A name of ``ours`` stays ours.

    Where two packages have one name neither has it: which came first would be chance.
    """
    points = sorted(
        (Declared(point.name, point.value, point.dist.name if point.dist else "?"))
        for point in entry_points(group=group)
    )

    def taken(one: Declared) -> str:
        if one.name in ours:
            return "Longreach's own has this name"
        others = [other.package for other in points if other.name == one.name and other is not one]
        return f"{' and '.join(others)} has one of this name too" if others else ""

    return [one._replace(taken=taken(one)) for one in points]


def installed(group: str, ours: Collection[str], judge: Callable[[str, Any], T]) -> Extensions[T]:
    """Every extension of ``group``, loaded. ``judge``: what a name's object is used as.

    It raises ConfigurationError for what it is not; whatever else loading raises is the package's own fault.
    """
    found: dict[str, T] = {}
    packages: dict[str, str] = {}
    left_out: list[LeftOut] = []
    points = {(p.name, p.value, p.dist.name if p.dist else "?"): p for p in entry_points(group=group)}
    for one in declared(group, ours):
        if one.taken:
            left_out.append(LeftOut(one, "extension.name_taken", one.taken))
            continue
        try:
            found[one.name] = judge(one.name, points[one[:3]].load())
            packages[one.name] = one.package
        except ConfigurationError as error:
            left_out.append(LeftOut(one, error.cause, str(error)))
        except Exception as error:  # an import runs foreign code
            why = f"{one.place}: {type(error).__name__}: {error}"
            left_out.append(LeftOut(one, "extension.not_loaded", why))
    return Extensions(found, packages, tuple(left_out))


def of_type(kind: type[T], wanted: str, value: Any) -> T:
    """``value``, which is one. Raises ConfigurationError (``extension.wrong_type``)."""
    if isinstance(value, kind):
        return value
    raise ConfigurationError("extension.wrong_type", f"wanted {wanted}, it is a {type(value).__name__}")


def lines(extensions: Extensions[Any]) -> Iterator[tuple[str, str]]:
    """Cause and sentence of each that was left out, for a log."""
    for one in extensions.left_out:
        yield one.cause, str(one)
