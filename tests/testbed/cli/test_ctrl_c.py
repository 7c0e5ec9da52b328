"""Which commands are long, so that Ctrl-C tells what is kept; and what is half made does not stay."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from testbed.cli.main import app
from testbed.reporting.console import long_command, nothing_half_made, promised

SHORT = {
    "arm check", "arm draw", "arm list", "arm new", "camera check", "camera convert", "config list", "doctor",
    "export mjcf", "export srdf", "export urdf", "hand-eye compare", "hand-eye drawing",
    "hand-eye intrinsics", "hand-eye samples", "hand-eye solve", "init", "markers",
    "programs", "runs list", "runs open", "runs show", "target", "token new",
    *(f"hand-eye session {step}" for step in (
        "back", "export", "go", "list", "locate", "next", "propose", "redo", "remove", "resume", "sample",
        "solve", "start",
    )),
}  # fmt: skip


def leaves(group: Any, before: tuple[str, ...] = ()) -> Iterator[str]:
    for name in group.list_commands(None):
        at = (*before, name)
        later = name in getattr(group, "later", {})
        inner = group.load(name) if later and name != "experiment" else group.get_command(None, name)
        if hasattr(inner, "list_commands"):
            yield from leaves(inner, at)
        else:
            yield " ".join(at)


def test_every_command_is_long_or_known_to_be_short() -> None:
    every = set(leaves(typer.main.get_command(app)))
    assert len(every) > 50
    assert {name for name in every if long_command(name.split()) is None} == SHORT


def test_what_is_half_made_goes_and_what_was_there_stays(tmp_path: Path) -> None:
    made, there = tmp_path / "made", tmp_path / "there"
    there.write_text("of somebody else")
    for target in (made, there):
        with pytest.raises(KeyboardInterrupt), nothing_half_made():  # noqa: PT012  the end raises
            promised(target).write_text("half")
            raise KeyboardInterrupt
    assert not made.exists()
    assert there.exists()
