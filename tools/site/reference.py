"""Every key of every configuration file: shipped value, what is allowed, what the file says of it."""

import inspect
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

import longreach
from testbed.cli.main import app
from testbed.scenarios.configuration_keys import allowed, keys, left_out
from testbed.scenarios.scenario import MODELS
from tools.tables import table

Row = tuple[str, str]
"""Names of an option, and what it is for."""
_MANY = 5  # commands from which on an option that says the same in each of them is told once


def commands_page(root: typer.Typer = app) -> str:
    """The reference of every command that can be run, by its words, in the order of the help.

    Options that many commands share come first, and are only named with the command.
    """
    found = list(_below(typer.main.get_command(root), "longreach", None))
    rows = {path: _rows(path, command) for path, command in found}
    counts = Counter(row for each in rows.values() for row in each)
    shared = [row for row, count in counts.items() if count >= _MANY]
    first = ["## Options that many commands have\n\n" + table("option | what", shared)] if shared else []
    return "\n\n".join([*first, *(_command(path, one, rows[path], shared) for path, one in found)])


def _below(command: Any, path: str, parent: Any) -> Iterator[tuple[str, Any]]:
    context = command.context_class(command, info_name=path, parent=parent)
    if not hasattr(command, "list_commands"):
        yield path, command
        return
    for name in command.list_commands(context):
        _, found, _ = command.resolve_command(context, [name])  # loads what is loaded when it is asked for
        if not found.hidden:
            yield from _below(found, f"{path} {name}", context)


def _rows(path: str, command: Any) -> list[Row]:
    context = command.context_class(command, info_name=path)
    rows = (_row(parameter, context) for parameter in command.get_params(context))
    return [row for row in rows if row]


def _command(path: str, command: Any, rows: list[Row], shared: list[Row]) -> str:
    usage = " ".join([path, *command.collect_usage_pieces(command.context_class(command, info_name=path))])
    parts = [f"## {path}", _text(command.help or ""), f"```\n{usage}\n```"]
    if own := [row for row in rows if row not in shared]:
        parts.append(table("option | what", own))
    if common := [re.findall(r"--[\w-]+", names)[0] for names, what in rows if (names, what) in shared]:
        parts.append(f"And `{'`, `'.join(common)}`.")
    if command.epilog:
        parts.append(
            f"{_text(command.epilog.partition('Example: ')[0])}\n```\n{_example(command.epilog)}\n```"
        )
    return "\n\n".join(part for part in parts if part.strip())


def _example(epilog: str) -> str:
    return epilog.partition("Example: ")[2] or epilog


def _row(parameter: Any, context: Any) -> Row | None:
    record = parameter.get_help_record(context)
    if record is None or parameter.name == "help":
        return None
    names, meaning = record
    return f"`{names}`".replace("|", "\\|"), _text(meaning)


def _text(text: str) -> str:
    joined = re.sub(r"(?<!\n)\n(?!\n)", " ", text.strip()).replace("\b", "")
    return re.sub(r"([*<|\[_])", r"\\\1", joined) if "`" not in joined else joined.replace("|", "\\|")


CONFIGS = Path(__file__).parents[2] / "configs"
_LONGEST = 60  # characters of a value that is shown


def page() -> str:
    """The reference of all configuration files, in Markdown."""
    return "\n\n".join(_file(name) for name in MODELS)


def _file(name: str) -> str:
    schema = MODELS[name].model_json_schema()
    written = list(keys(CONFIGS / f"{name}.yaml"))
    rows = [
        (f"`{key.path}`", _code(key.value), allowed(schema, key.path), _cell(key.comment)) for key in written
    ]
    rows += [
        (f"`{path}`", _code(f"not written: {value}"), allowed(schema, path), "")
        for path, value in left_out(schema, {key.path for key in written})
    ]
    return f"## {name}.yaml\n\n" + table("key | shipped | allowed | what the file says", rows)


def _code(value: str) -> str:
    shown = value if len(value) <= _LONGEST else value[:_LONGEST] + " …"
    return f"`{_cell(shown)}`" if shown else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;") if text else text


def python_page() -> str:
    """What ``import longreach`` has: every public name with its signature and docstring, methods below."""
    return "\n\n".join(
        _documented(f"longreach.{name}", getattr(longreach, name)) for name in longreach.__all__
    )


def _documented(path: str, thing: Any) -> str:
    if inspect.ismodule(thing):
        return f"## {path}\n\n{_docstring(thing)}"
    parts = [f"## {path}", f"```\n{path}{_signature(thing)}\n```", _docstring(thing)]
    made = inspect.signature(thing).return_annotation if inspect.isfunction(thing) else thing
    for name, member in inspect.getmembers(made) if inspect.isclass(made) and made is not str else ():
        public = not name.startswith("_") and getattr(member, "__module__", "").startswith("longreach")
        if public and inspect.isfunction(member):
            parts.append(f"- `.{name}{_signature(member)}`: {_one_line(member)}")
        elif isinstance(member, property) and not name.startswith("_"):
            parts.append(f"- `.{name}`: {_one_line(member)}")
    return "\n\n".join(part for part in parts if part)


def _signature(thing: Any) -> str:
    """Names and defaults; types and what each means are in the docstring."""
    given = inspect.signature(thing).parameters.values()
    plain = [one.replace(annotation=one.empty) for one in given if one.name != "self"]
    shown = [one.replace(default=str(one.default)) if isinstance(one.default, Path) else one for one in plain]
    return f"({', '.join(map(str, shown))})"


def _docstring(thing: Any) -> str:
    return _text(inspect.getdoc(thing) or "")


def _one_line(thing: Any) -> str:
    return " ".join(_docstring(thing).split())
