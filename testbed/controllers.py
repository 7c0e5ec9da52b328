"""Which controllers there are to choose from."""

from enum import StrEnum


class ControllerKind(StrEnum):
    """In which language the controller is written that runs; the value is the option's."""

    PYTHON = "python"
    STRUCTURED_TEXT = "st"

    @property
    def module(self) -> str:
        """What is run as its process."""
        return "controller" if self is ControllerKind.PYTHON else "controller_st"
