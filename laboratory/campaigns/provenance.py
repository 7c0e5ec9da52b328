"""What a row is evidence of: the sources that made it, the files they read, and the libraries' versions.

A hash of all of them is part of every row's configuration: a row is reused only while none has changed.
"""

import ast
import hashlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from foundation.configuration import layers
from testbed.reporting.run_record import library_versions

PACKAGES = (
    "foundation",
    "protocol",
    "nominal_arm",
    "controller",
    "plant_emulator",
    "vision_pc",
    "conformance",
    "dissector",
    "testbed",
    "laboratory",
    "longreach",
)
_SCENARIOS = "scenarios"
_DIGITS = 16


class Provenance(NamedTuple):
    """The code behind a run: hash of the sources, and the versions of Python, Longreach and libraries."""

    function: str
    sources: str
    versions: Mapping[str, str]


def provenance_of(function: Callable[..., Any]) -> Provenance:
    """The provenance of a campaign's function, or of a partial of such."""
    while isinstance(function, partial):
        function = function.func
    module = function.__module__
    return Provenance(f"{module}.{function.__qualname__}", sources_hash(module), library_versions())


@cache
def sources_hash(module: str) -> str:
    """The hash of the sources of ``module`` and of all of ours that it imports, directly or not."""
    package = module.partition(".")[0]
    roots = {name: _root(name) for name in {*PACKAGES, package}}
    sources = imported_sources(module, {name: root for name, root in roots.items() if root is not None})
    return _hash((name.encode(), sources[name].read_bytes()) for name in sorted(sources))


def imported_sources(module: str, roots: Mapping[str, Path]) -> dict[str, Path]:
    """Module name → file, for ``module`` and what it imports, directly or not, of the packages ``roots``.

    ``roots``: top-level package → its directory (or file). Imports inside of functions count too.
    """
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = None if name in found else _file_of(name, roots)
        if path is None:
            continue
        found[name] = path
        waiting += [name.rpartition(".")[0], *_imports(ast.parse(path.read_bytes()))]
    return found


def _imports(tree: ast.AST) -> Iterator[str]:
    """Every name that may be an imported module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _file_of(name: str, roots: Mapping[str, Path]) -> Path | None:
    package, *inner = name.split(".")
    if package not in roots:
        return None
    path = roots[package].joinpath(*inner)
    candidates = (path / "__init__.py", path.with_suffix(".py"), path)
    return next((file for file in candidates if file.suffix == ".py" and file.is_file()), None)


def _root(package: str) -> Path | None:
    """Where a package lies from which this process imports; None where there is none."""
    if package in sys.modules:
        file = sys.modules[package].__file__
        path = None if file is None else Path(file)
    else:
        beside = Path(__file__).parents[2] / package
        path = beside / "__init__.py"
    if path is None or not path.is_file():
        return None
    return path.parent if path.name == "__init__.py" else path


def content_hash(path: Path, scenario: str | None = None) -> str:
    """The hash of a file, or of all files below a directory and its base, with their names; "" for none.

    Of the files in ``scenarios/`` only that of ``scenario`` counts, where one is named.
    """
    if path.is_file():
        return _hash([(b"", path.read_bytes())])
    files = [
        (str(file.relative_to(directory)).encode(), file.read_bytes())
        for directory in layers(path)
        for file in sorted(directory.rglob("*"))
        if file.is_file() and _readable(file, scenario)
    ]
    return _hash(files) if files else ""


def _readable(file: Path, scenario: str | None) -> bool:
    return scenario is None or file.parent.name != _SCENARIOS or file.stem == scenario


def _hash(parts: Iterable[tuple[bytes, bytes]]) -> str:
    digest = hashlib.sha256()
    for name, content in parts:
        digest.update(b"%d %d\0" % (len(name), len(content)) + name + content)
    return digest.hexdigest()[:_DIGITS]
