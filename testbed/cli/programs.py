"""`longreach programs`: what can be run and broken, of ours and of installed packages."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from foundation.extensions import Extensions
from plant_emulator.core.faults.kinds import FAULTS
from plant_emulator.shell.installed_faults import every_kind, installed_faults
from protocol.errors import ConfigurationError
from testbed.experiments.catalogue import OURS, added, catalogue
from testbed.reporting.console import out, words, write_json
from vision_pc.shell.installed_programs import every_program, installed_programs

_OURS = "longreach"
_KINDS = ("program", "disturbance", "experiment")


class Runnable(NamedTuple):
    """One row: what it is, its name, what it does, whose it is, and why it cannot be run ("": it can)."""

    kind: str
    name: str
    shows: str
    package: str
    trouble: str = ""


def list_programs(json_file: Path | None) -> bool:
    """Whether all that installed packages add can be run; prints it beside ours."""
    rows = [*_programs(), *_disturbances(), *_experiments()]
    for kind in _KINDS:
        fine = [(row.name, row.shows, row.package) for row in rows if row.kind == kind and not row.trouble]
        out.print(words(f"{kind}s", ("name", "what it does", "of"), fine))
    wrong = [(row.kind, row.name, row.package, row.trouble) for row in rows if row.trouble]
    if wrong:
        out.print(words("left out", ("", "name", "of", "why"), wrong))
    told = {f"{kind}s": [row._asdict() for row in rows if row.kind == kind] for kind in _KINDS}
    write_json(json_file, told)
    return not wrong


def _programs() -> Iterator[Runnable]:
    packages = installed_programs().packages
    for program in every_program():
        yield Runnable("program", program.name, program.title, packages.get(program.name, _OURS))
    yield from _left_out("program", installed_programs())


def _disturbances() -> Iterator[Runnable]:
    packages = installed_faults().packages
    for name, kind in every_kind().items():
        told = (kind.__doc__ or "").partition("\n")[0]
        yield Runnable("disturbance", name, told, _OURS if name in FAULTS else packages[name])
    yield from _left_out("disturbance", installed_faults())


def _experiments() -> Iterator[Runnable]:
    """Ours are not loaded: that they can be is tested."""
    for name, entry in OURS.items():
        yield Runnable("experiment", name, f"{entry.shows} ({entry.cost} a run)", _OURS)
    for one in added():
        row = Runnable("experiment", one.name, "", one.package)
        if one.taken:
            yield row._replace(trouble=f"extension.name_taken: {one.taken}")
            continue
        try:
            yield row._replace(shows=catalogue()[one.name].load().title)
        except ConfigurationError as error:
            yield row._replace(trouble=f"{error.cause}: {error}")


def _left_out(kind: str, extensions: Extensions[Any]) -> Iterator[Runnable]:
    for one in extensions.left_out:
        yield Runnable(kind, one.declared.name, "", one.declared.package, f"{one.cause}: {one.why}")
