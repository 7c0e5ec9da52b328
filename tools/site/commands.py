"""Every command of ``longreach`` with its arguments and options, as `--help` tells them, in Markdown."""

import re
from collections.abc import Iterator
from typing import Any

import typer

from testbed.cli.main import app
from tools.tables import table


def page(root: typer.Typer = app) -> str:
    """The reference of every command that can be run, by its words, in the order of the help."""
    found = _below(typer.main.get_command(root), "longreach", None)
    return "\n\n".join(_command(path, command) for path, command in found)


def _below(command: Any, path: str, parent: Any) -> Iterator[tuple[str, Any]]:
    context = command.context_class(command, info_name=path, parent=parent)
    if not hasattr(command, "list_commands"):
        yield path, command
        return
    for name in command.list_commands(context):
        _, found, _ = command.resolve_command(context, [name])  # loads what is loaded when it is asked for
        if not found.hidden:
            yield from _below(found, f"{path} {name}", context)


def _command(path: str, command: Any) -> str:
    context = command.context_class(command, info_name=path)
    usage = " ".join([path, *command.collect_usage_pieces(context)])
    rows = [_row(parameter, context) for parameter in command.get_params(context)]
    parts = [f"## {path}", _text(command.help or ""), f"```\n{usage}\n```"]
    if shown := [row for row in rows if row]:
        parts.append(table("option | what", shown))
    if command.epilog:
        parts.append(
            f"{_text(command.epilog.partition('Example: ')[0])}\n```\n{_example(command.epilog)}\n```"
        )
    return "\n\n".join(part for part in parts if part.strip())


def _example(epilog: str) -> str:
    return epilog.partition("Example: ")[2] or epilog


def _row(parameter: Any, context: Any) -> tuple[str, str] | None:
    record = parameter.get_help_record(context)
    if record is None or parameter.name == "help":
        return None
    names, told = record
    return f"`{names}`".replace("|", "\\|"), _text(told)


def _text(text: str) -> str:
    joined = re.sub(r"(?<!\n)\n(?!\n)", " ", text.strip()).replace("\b", "")
    return re.sub(r"([*<|\[_])", r"\\\1", joined) if "`" not in joined else joined.replace("|", "\\|")
