"""The suites are a product: they run wherever ``protocol``, the floor under it and two libraries for a
terminal are installed."""

import ast
import sys
from pathlib import Path

import conformance

ALLOWED = {"protocol", "foundation", "typer", "rich"}


def imported(path: Path) -> set[str]:
    """Dotted names of everything that a module imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: relative import"
            names.add(node.module or "")
    return names


def test_the_suites_import_the_protocol_the_floor_and_themselves() -> None:
    modules = sorted(Path(conformance.__file__).parent.rglob("*.py"))
    assert len(modules) > 15
    for path in modules:
        for name in imported(path):
            top = name.partition(".")[0]
            own = name == "conformance" or name.startswith("conformance.")
            assert own or top in ALLOWED or top in sys.stdlib_module_names, f"{path.name} imports {name}"
