"""Every key of every configuration file: shipped value, what is allowed, what the file says of it."""

import inspect
import re
from pathlib import Path
from typing import Any

import typer
from typer.cli import get_docs_for_click

import longreach
from testbed.cli.main import app
from testbed.scenarios.configuration_keys import allowed, keys, left_out
from testbed.scenarios.scenario import MODELS
from tools.tables import table


def commands_page() -> str:
    """The reference of every command that can be run, in the order of the help, as Typer documents it."""
    command = typer.main.get_command(app)
    return get_docs_for_click(obj=command, ctx=typer.Context(command, info_name="longreach"), indent=1)


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
