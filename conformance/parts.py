"""The parts that an implementation may leave out, and the profile that says which it claims to have."""

from collections.abc import Iterable
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from foundation.configuration import StrictModel, load
from protocol.errors import ConfigurationError


class OptionalPart(Enum):
    """What a controller or coupler may lack and still keep to the page; the value is its name."""

    PATHS = "paths"
    STREAMING = "streaming"
    AUTHENTICATION = "authentication"
    KEY_REFUSAL = "key-refusal"
    MOTION = "motion"
    OUTPUTS = "outputs"


BASE = "base"


class Profile(NamedTuple):
    """Which optional parts are claimed: what is claimed must be there, what is not is not asked for."""

    name: str
    claims: frozenset[OptionalPart]


class ProfileFile(StrictModel):
    """A profile as a YAML file: ``claims`` lists the parts by name."""

    claims: list[OptionalPart]


def profile_from(text: str) -> Profile:
    """The profile that ``text`` names: a YAML file, part names joined by commas, or ``base`` for none.

    Raises ConfigurationError for a file that is not one and for a part that does not exist.
    """
    path = Path(text)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return _profile(text, load(ProfileFile, path).claims)
    names = [name.strip() for name in text.split(",") if name.strip() not in ("", BASE)]
    known = {part.value: part for part in OptionalPart}
    for name in names:
        if name not in known:
            raise ConfigurationError(
                "conformance.unknown_part",
                f"--profile {name}: no such part; there are {', '.join(known)}, {BASE}",
            )
    return _profile(text, [known[name] for name in names])


def _profile(name: str, claims: Iterable[OptionalPart]) -> Profile:
    parts = set(claims)
    if OptionalPart.AUTHENTICATION in parts:
        parts.add(OptionalPart.KEY_REFUSAL)
    return Profile(name, frozenset(parts))
