"""The house in numbers: lines, statements, imports, long functions, many parameters, names used twice.

``python -m tests.house.measures`` prints them for this checkout; give another checkout's folder to compare.
A statement is an ``ast.stmt`` that is neither an import nor a docstring: merged modules, joined lines and
dropped blank lines leave it as it is.
"""

import ast
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, NamedTuple

import yaml

ROOT = Path(__file__).parents[2]
_NOT_SOURCE = {"tests", "runs", "dist", "build"}
_PAGES_OF_CODE = {".st", ".js", ".css", ".html"}
MAX_LINES, MAX_PARAMETERS, MAX_ROOMS = 40, 8, 20
SERVICES = ("controller", "plant_emulator", "vision_pc")

Function = ast.FunctionDef | ast.AsyncFunctionDef


class Module(NamedTuple):
    """One Python file: its dotted name, path, text and tree."""

    name: str
    path: Path
    text: str
    tree: ast.Module

    @property
    def package(self) -> str:
        """The folder on top in which it lies."""
        return self.name.split(".")[0]


class Named(NamedTuple):
    """A function with its place, and how many lines (docstring not counted) or parameters it has."""

    place: str
    count: int


def files(root: Path, *suffixes: str) -> list[Path]:
    """All files of a checkout with one of the suffixes, without hidden folders and what is made."""
    tops = [
        root,
        *(path for path in root.iterdir() if path.is_dir() and path.name not in _NOT_SOURCE - {"tests"}),
    ]
    found = [
        p
        for top in tops
        if top.name[0] != "." or top == root
        for p in (top.rglob("*") if top != root else top.iterdir())
    ]
    return sorted(path for path in found if path.suffix in suffixes and path.is_file())


@cache
def modules(root: Path) -> list[Module]:
    """All Python files of a checkout, tests too, by name."""
    found = []
    for path in files(root, ".py"):
        text = path.read_text(encoding="utf-8")
        name = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        found.append(Module(name, path, text, ast.parse(text)))
    return found


def source_of(every: list[Module]) -> list[Module]:
    """Those that are no tests."""
    return [module for module in every if module.package != "tests"]


def functions(module: Module) -> Iterator[tuple[str, Function]]:
    """Every function and method of a module with its place, such as ``protocol/pose.py:12 unit``."""
    for node in ast.walk(module.tree):
        if isinstance(node, Function):
            yield f"{module.name}:{node.lineno} {node.name}", node


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def statements(every: Iterable[Module]) -> int:
    """Statements of modules, imports and docstrings not counted."""
    nodes = (node for module in every for node in ast.walk(module.tree) if isinstance(node, ast.stmt))
    return sum(not isinstance(node, ast.Import | ast.ImportFrom) and not _is_text(node) for node in nodes)


def lines(every: Iterable[Module]) -> int:
    """Lines of modules."""
    return sum(len(module.text.splitlines()) for module in every)


def long_functions(every: list[Module]) -> list[Named]:
    """Functions over 40 lines, the docstring not counted."""
    found = []
    for place, node in (pair for module in every for pair in functions(module)):
        first = node.body[0]
        text = (first.end_lineno or 0) - first.lineno + 1 if _is_text(first) else 0
        count = (node.end_lineno or 0) - node.lineno + 1 - text
        if count > MAX_LINES:
            found.append(Named(place, count))
    return found


def many_parameters(every: list[Module]) -> list[Named]:
    """Functions with more than eight parameters (self and cls not counted)."""
    found = []
    for place, node in (pair for module in every for pair in functions(module)):
        parameters = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        count = sum(parameter.arg not in ("self", "cls") for parameter in parameters)
        if count > MAX_PARAMETERS:
            found.append(Named(place, count))
    return found


def names_used_twice(every: list[Module]) -> dict[str, list[str]]:
    """Public class names that more than one module defines, with these modules."""
    places: dict[str, list[str]] = defaultdict(list)
    for module in every:
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(module.name)
    return {name: where for name, where in sorted(places.items()) if len(where) > 1}


def rooms(every: list[Module]) -> dict[str, int]:
    """For each source folder how many modules and folders lie in it; ``__init__.py`` is its door."""
    inside: dict[str, set[str]] = defaultdict(set)
    for module in source_of(every):
        parts = module.path.relative_to(
            ROOT if ROOT in module.path.parents else module.path.parents[-2]
        ).parts
        for depth in range(1, len(parts)):
            if parts[depth] != "__init__.py":
                inside["/".join(parts[:depth])].add(parts[depth])
    return {folder: len(names) for folder, names in inside.items()}


def imports(every: list[Module]) -> set[tuple[str, str]]:
    """Which module imports which of ours, ``TYPE_CHECKING`` blocks and functions' own imports included."""
    known = {module.name for module in every}
    arrows = set()
    for module in every:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    arrows.add((module.name, inner if inner in known else node.module))
            elif isinstance(node, ast.Import):
                arrows |= {(module.name, alias.name) for alias in node.names}
    return {(a, b) for a, b in arrows if b in known and a != b}


def closure(every: list[Module], starts: tuple[str, ...]) -> list[Module]:
    """What the packages ``starts`` reach by imports, their own modules and the packages' doors included."""
    reached = {module.name for module in every if module.package in starts}
    forward = defaultdict(set)
    for a, b in imports(every):
        forward[a].add(b)
    todo = list(reached)
    while todo:
        for name in forward[todo.pop()] - reached:
            reached.add(name)
            todo.append(name)
    doors = {".".join(name.split(".")[:depth]) for name in reached for depth in range(1, name.count(".") + 1)}
    return [module for module in every if module.name in reached | doors]


def arrows_between_rooms(folder: str, arrows: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Arrows between what lies in ``folder`` (dotted; "" is the top), each file or folder below as one."""
    prefix = f"{folder}." if folder else ""

    def room(name: str) -> str:
        return name.removeprefix(prefix).split(".")[0] if name.startswith(prefix) else ""

    pairs = {(room(a), room(b)) for a, b in arrows}
    return {(a, b) for a, b in pairs if a and b and a != b}


def circle(arrows: set[tuple[str, str]]) -> list[str]:
    """Names that import each other in a circle; empty: there is none."""
    graph: dict[str, set[str]] = defaultdict(set)
    for a, b in arrows:
        graph[a].add(b)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as found:
        return list(found.args[1])
    return []


PARTS = {
    "conformance": ("conformance", "dissector"),
    "laboratory": ("laboratory",),
    "structured text": ("structured_text", "controller_st"),
    "ROS 2": ("longreach_ros2",),
}
"""Part of the house → its packages: distributions of their own; what is left is the product."""


def mass(root: Path) -> dict[str, int]:
    """What a person who takes the house over has to read."""
    every = modules(root)
    source, tests = source_of(every), [module for module in every if module.package == "tests"]
    part_of = {package: part for part, packages in PARTS.items() for package in packages}
    by_part: Counter[str] = Counter()
    for module in source:
        by_part[part_of.get(module.package, "the product")] += statements([module])
    own = [p for p in files(root, *_PAGES_OF_CODE) if "vendor" not in p.parts and "tests" not in p.parts]
    pages = [
        path for path in files(root, ".md") if path.parent.name != "reference" and "vendor" not in path.parts
    ]

    def words(paths: list[Path]) -> int:  # a table's bars are none
        tokens = (token for path in paths for token in path.read_text(encoding="utf-8").split())
        return sum(any(map(str.isalnum, token)) for token in tokens)

    return {
        "lines of source": lines(source),
        "statements of source": statements(source),
        **{f"statements of {part}": count for part, count in sorted(by_part.items())},
        "lines that the three services import": lines(closure(source, SERVICES)),
        "lines of tests": lines(tests),
        "statements of tests": statements(tests),
        "lines of structured text, JavaScript, CSS and HTML": sum(
            len(p.read_text(encoding="utf-8").splitlines()) for p in own
        ),
        "modules": len(source),
        "words of pages": words(pages),
        "words of the README": words([root / "README.md"]),
        "configuration keys": len(configuration_keys(root / "configs")),
        "constants of vision without a tag": len(untagged_constants(root / "vision_pc" / "core")),
        "constants of the controller without a tag": len(untagged_constants(root / "controller" / "core")),
    }


_ALIKE = re.compile(r"\.(slew|lift|tilt|wrist[123]|left|right|servo|mobile|boom|arm|valve_sets)(?=\.)")


def configuration_keys(configs: Path) -> set[str]:
    """The keys of the base files; what is said again of each joint, eye, boom or valve set counts once."""

    def leaves(node: dict[str, Any], path: str) -> Iterator[str]:
        for key, value in node.items():
            below = f"{path}.{key}"
            yield from leaves(value, below) if isinstance(value, dict) else (_ALIKE.sub(".*", below),)

    bases = ("arm", "controller", "plant", "plant_service", "scene", "vision")
    texts = {base: (configs / f"{base}.yaml").read_text(encoding="utf-8") for base in bases}
    return {key for base, text in texts.items() for key in leaves(yaml.safe_load(text), base)}


_CONSTANT = re.compile(r"^_?[A-Z][A-Z0-9_]*(?:, _?[A-Z][A-Z0-9_]*)* = -?[\d(].*$", re.MULTILINE)


def untagged_constants(folder: Path) -> list[str]:
    """Module-level numbers below ``folder`` on lines without a tag of their source: [S], [M], [E] or [D]."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.py"))}
    lines_of = [(name, line) for name, text in texts.items() for line in _CONSTANT.findall(text)]
    return [f"{name}: {line}" for name, line in lines_of if not re.search(r"\[[SMED]\]", line)]


if __name__ == "__main__":
    for what, count in mass(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT).items():
        print(f"{what:<52}{count:>8}")
