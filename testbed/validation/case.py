"""One validation case as data: what was expected, what came out, how far apart they may be."""

from typing import Literal, NamedTuple

Relation = Literal["near", "at_most", "at_least"]


class ValidationCase(NamedTuple):
    """A case with a known answer. ``tolerance`` is absolute, in ``unit``; it widens a bound as well.

    ``source`` says where the expected value comes from.
    """

    family: int
    name: str
    unit: str
    expected: float
    obtained: float
    tolerance: float
    source: str
    relation: Relation = "near"

    @property
    def passed(self) -> bool:
        """Whether the obtained value is where it should be; NaN never is."""
        if self.relation == "at_most":
            return self.obtained <= self.expected + self.tolerance
        if self.relation == "at_least":
            return self.obtained >= self.expected - self.tolerance
        return abs(self.obtained - self.expected) <= self.tolerance
