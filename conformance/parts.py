"""The parts that an implementation may leave out, and the profile that says which it claims to have."""

from enum import Enum

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


Profile = frozenset[OptionalPart]
"""Which optional parts are claimed: what is claimed must be there, what is not is not asked for."""


def profile_from(text: str) -> Profile:
    """The parts that ``text`` names, joined by commas, or ``base`` for none.

    Raises ConfigurationError for a part that does not exist.
    """
    names = {name.strip() for name in text.split(",")} - {"", BASE}
    known = {part.value: part for part in OptionalPart}
    for name in sorted(names - known.keys()):
        why = f"--profile {name}: no such part; there are {', '.join(known)}, {BASE}"
        raise ConfigurationError("conformance.unknown_part", why)
    parts = frozenset(known[name] for name in names)
    keyed = OptionalPart.AUTHENTICATION in parts
    return parts | {OptionalPart.KEY_REFUSAL} if keyed else parts
