"""Programs of installed packages: entry points of ``longreach.programs``, NAME = ``module:PROGRAM``."""

import re
from functools import cache
from typing import Any

from foundation.extensions import Extensions, installed, of_type
from protocol.errors import ConfigurationError
from vision_pc.application.program import Program
from vision_pc.application.programs import PROGRAMS

GROUP = "longreach.programs"
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")  # is an address of the REST API


@cache
def installed_programs() -> Extensions[Program[Any, Any]]:
    """Those that can be run beside ours, and those that were left out."""
    return installed(GROUP, [program.name for program in PROGRAMS], _program_of)


def every_program() -> tuple[Program[Any, Any], ...]:
    """Ours, then those of installed packages."""
    return (*PROGRAMS, *installed_programs().found.values())


def _program_of(name: str, value: Any) -> Program[Any, Any]:
    program: Program[Any, Any] = of_type(Program, "a vision_pc.application.program.Program", value)
    if program.name != name or not _NAME.fullmatch(name):
        why = f"the program calls itself {program.name!r}: wanted the same name, such as there-and-back"
        raise ConfigurationError("extension.wrong_name", why)
    return program
