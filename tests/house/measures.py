"""The house in numbers: lines, rooms, imports, long functions, many parameters, names used twice.

``python -m tests.house.measures`` prints them for this checkout; give another checkout's folder to compare.
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml

ROOT = Path(__file__).parents[2]
_NOT_SOURCE = {"tests", "docs", "configs", "runs", "dist", "build"}
MAX_LINES, MAX_PARAMETERS, MAX_ROOMS = 40, 8, 20

Function = ast.FunctionDef | ast.AsyncFunctionDef


class Module(NamedTuple):
    """One source file: its dotted name, path, text and tree."""

    name: str
    path: Path
    text: str
    tree: ast.Module


class Named(NamedTuple):
    """A function with its place, and how many lines (docstring not counted) or parameters it has."""

    place: str
    count: int
    compiled: bool


def packages(root: Path) -> list[str]:
    """The source packages of a checkout: folders on top with an ``__init__.py`` that are no tests."""
    return sorted(
        path.parent.name for path in root.glob("*/__init__.py") if path.parent.name not in _NOT_SOURCE
    )


def modules(root: Path) -> list[Module]:
    """All source modules of a checkout, by name."""
    found = []
    for package in packages(root):
        for path in sorted((root / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            found.append(Module(name.removesuffix(".__init__"), path, text, ast.parse(text)))
    return found


def functions(module: Module) -> Iterator[tuple[str, Function]]:
    """Every function and method of a module with its place, such as ``protocol/pose.py:12 unit``."""
    for node in ast.walk(module.tree):
        if isinstance(node, Function):
            yield f"{module.name}:{node.lineno} {node.name}", node


def is_compiled(function: Function) -> bool:
    """Whether numba compiles it: its decorator says kernel, njit or compiled."""
    names = (ast.unparse(decorator) for decorator in function.decorator_list)
    return any(word in name for name in names for word in ("njit", "kernel", "compiled"))


def long_functions(every: list[Module]) -> list[Named]:
    """Functions over 40 lines, the docstring not counted, longest first."""
    found = []
    for module in every:
        for place, node in functions(module):
            first = node.body[0]
            documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
            text = (first.end_lineno or 0) - first.lineno + 1 if documented else 0
            lines = (node.end_lineno or 0) - node.lineno + 1 - text
            if lines > MAX_LINES:
                found.append(Named(place, lines, is_compiled(node)))
    return sorted(found, key=lambda named: -named.count)


def many_parameters(every: list[Module]) -> list[Named]:
    """Functions with more than eight parameters (self and cls not counted), most first."""
    found = []
    for module in every:
        for place, node in functions(module):
            asked = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            count = len([name for name in asked if name not in ("self", "cls")])
            if count > MAX_PARAMETERS:
                found.append(Named(place, count, is_compiled(node)))
    return sorted(found, key=lambda named: -named.count)


def names_used_twice(every: list[Module]) -> dict[str, list[str]]:
    """Public class names that more than one module defines, with these modules."""
    places: dict[str, list[str]] = defaultdict(list)
    for module in every:
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(module.name)
    return {name: where for name, where in sorted(places.items()) if len(where) > 1}


def rooms(root: Path) -> dict[str, int]:
    """For each source folder how many modules and folders lie in it; ``__init__.py`` is its door."""
    counts = {}
    for package in packages(root):
        for folder in (root / package, *(root / package).rglob("*")):
            if folder.is_dir() and folder.name != "__pycache__" and any(folder.glob("*.py")):
                inside = [p for p in folder.glob("*.py") if p.name != "__init__.py"]
                below = [p for p in folder.iterdir() if p.is_dir() and any(p.glob("*.py"))]
                counts[str(folder.relative_to(root))] = len(inside) + len(below)
    return counts


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


def arrows_between_rooms(folder: str, arrows: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Arrows between what lies in ``folder`` (dotted; "" is the top), each file or folder below as one."""
    prefix = f"{folder}." if folder else ""

    def room(name: str) -> str | None:
        inside = name.removeprefix(prefix) if name.startswith(prefix) else ""
        return inside.split(".")[0] or None

    pairs = {(room(a), room(b)) for a, b in arrows}
    return {(a, b) for a, b in pairs if a and b and a != b}


def circles(arrows: set[tuple[str, str]]) -> list[list[str]]:
    """Groups that reach each other by arrows, largest first (strongly connected, Kosaraju)."""
    forward, backward = defaultdict(set), defaultdict(set)
    for a, b in arrows:
        forward[a].add(b)
        backward[b].add(a)
    order: list[str] = []
    seen: set[str] = set()
    for start in sorted({name for arrow in arrows for name in arrow}):
        order += _reached(start, forward, seen)
    found, seen = [], set()
    for start in reversed(order):
        group = _reached(start, backward, seen)
        if len(group) > 1:
            found.append(sorted(group))
    return sorted(found, key=len, reverse=True)


def _reached(start: str, arrows: dict[str, set[str]], seen: set[str]) -> list[str]:
    """What ``start`` reaches and was not seen, in the order in which it was left."""
    if start in seen:
        return []
    seen.add(start)
    left: list[str] = []
    path = [(start, iter(sorted(arrows[start])))]
    while path:
        name, rest = path[-1]
        following = next((n for n in rest if n not in seen), None)
        if following is None:
            left.append(name)
            path.pop()
        else:
            seen.add(following)
            path.append((following, iter(sorted(arrows[following]))))
    return left


def lines(root: Path, pattern: str) -> int:
    """Lines of all files of a pattern."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in root.glob(pattern))


PARTS = {
    "conformance": ("conformance",),
    "laboratory": ("laboratory",),
    "product": (
        "controller", "controller_st", "dissector", "examples", "foundation", "longreach", "nominal_arm",
        "plant_emulator", "protocol", "structured_text", "testbed", "tools", "vision_pc",
    ),
}  # fmt: skip
"""Part of the house → its packages: the suites and the laboratory are distributions of their own."""


def mass(root: Path) -> dict[str, int]:
    """What a person who takes the house over has to read: lines, words, modules, keys of a checkout."""
    sources = [path for package in packages(root) for path in (root / package).rglob("*.py")]
    every = [path for pattern in ("*.md", "docs/**/*.md", "examples/**/*.md") for path in root.glob(pattern)]
    pages = [path for path in every if path.parent.name != "reference"]  # looked up in, and made by a program

    def words(paths: list[Path]) -> int:  # a table's bars are none
        tokens = (token for path in paths for token in path.read_text(encoding="utf-8").split())
        return sum(any(map(str.isalnum, token)) for token in tokens)

    parts = {
        f"lines of {part}": sum(lines(root, f"{package}/**/*.py") for package in names)
        for part, names in PARTS.items()
    }
    return parts | {
        "modules": len(sources),
        "lines of source": sum(len(path.read_text(encoding="utf-8").splitlines()) for path in sources),
        "lines of tests": lines(root, "tests/**/*.py"),
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


def main(root: Path) -> None:
    """Print the figures of the checkout at ``root``."""
    every = modules(root)
    arrows = imports(every)
    for what, count in mass(root).items():
        print(f"{what:<24}{count:>8}")
    for package in packages(root):
        print(f"{package:<16}{lines(root, f'{package}/**/*.py'):>7} lines")
    by_size = sorted(rooms(root).items(), key=lambda item: -item[1])
    for folder, count in by_size[:6]:
        inside = arrows_between_rooms(folder.replace("/", "."), arrows)
        print(f"{folder}: {count} rooms, {len(inside)} arrows, {len(circles(inside))} circles")
    crowded = sum(count > MAX_ROOMS for count in rooms(root).values())
    print(f"folders with more than {MAX_ROOMS} rooms: {crowded}")
    crossed = [f for f in ("", *rooms(root)) if circles(arrows_between_rooms(f.replace("/", "."), arrows))]
    print(f"folders whose rooms form a circle: {len(crossed)} {crossed}")
    for title, found in (("lines", long_functions(every)), ("parameters", many_parameters(every))):
        limit = MAX_LINES if title == "lines" else MAX_PARAMETERS
        kernels = sum(named.compiled for named in found)
        print(f"functions over {limit} {title}: {len(found)}, of them compiled kernels: {kernels}")
    print(f"public class names used more than once: {len(names_used_twice(every))}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
