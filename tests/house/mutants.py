"""Random mistakes in a folder, and which tests find them: ``python -m tests.house.mutants FOLDER TESTS…``.

A mistake is drawn from the syntax of one file: a number, a comparison, an operator, a smallest or largest, a
condition turned round, an early return, a statement left out. Those tests run that come by its
line, on a copy of the sources, one mistake at a time. The same seed draws the same mistakes.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from coverage import CoverageData

from testbed.reporting.console import bars
from tests.house.measures import ROOT

TIMEOUT_S = 600.0  # a mistake that makes tests this slow has been found
COMPARISONS = {
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in",
}  # fmt: skip
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.And: "or", ast.Or: "and"}
EXTREMES = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "any": "all",
    "all": "any",
}


class Mutant(NamedTuple):
    """``text`` in place of the bytes from ``begin`` to ``end`` of ``file``, in a statement on ``lines``."""

    file: Path
    lines: range
    begin: int
    end: int
    before: str
    text: str

    def __str__(self) -> str:
        before, after = (" ".join(text.split())[:50] for text in (self.before, self.text))
        return f"{self.file}:{self.lines[0]}: {before} → {after}"


def _replacements(node: ast.expr | ast.stmt, source: str) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """What a mistake may write in place of ``node``, or of a part of it."""

    def of(part: ast.AST) -> str:
        return ast.get_source_segment(source, part) or ""

    match node:
        case ast.Constant(value=bool(value)):
            yield node, str(not value)
        case ast.Constant(value=int(value)):
            yield node, str(value + 1)
        case ast.Constant(value=float(value)):
            yield node, repr(value * 2.0 if value else 1.0)
        case ast.Compare(left=left, ops=[operator], comparators=[right]) if type(operator) in COMPARISONS:
            yield node, f"{of(left)} {COMPARISONS[type(operator)]} {of(right)}"
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in OPERATORS:
            yield node, f"{of(left)} {OPERATORS[type(operator)]} {of(right)}"
        case ast.BoolOp(op=operator, values=values):
            yield node, f" {OPERATORS[type(operator)]} ".join(f"({of(value)})" for value in values)
        case ast.Name(id=name) | ast.Attribute(attr=name) if name in EXTREMES:
            yield node, re.sub(rf"{name}$", EXTREMES[name], of(node))
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield node, of(operand)
        case ast.If(test=test) | ast.IfExp(test=test):
            yield test, f"not ({of(test)})"
        case ast.Expr(value=ast.Call()) | ast.AugAssign():
            yield node, "pass"
        case ast.Return(value=value) if value is not None and not isinstance(value, ast.Constant):
            yield value, "None"


def mutants(file: Path) -> list[Mutant]:
    """Every mistake that may be made in the file of ``ROOT``, outside of annotations."""
    source = (ROOT / file).read_text(encoding="utf-8")
    raw = source.encode()
    starts = [0, *accumulate(len(line) for line in raw.splitlines(keepends=True))]
    found = []
    for statement in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.stmt)):
        parts = _of_statement(statement)
        lines = range(statement.lineno, max(part.end_lineno or 0 for part in parts) + 1)
        for node in parts:
            for place, text in _replacements(node, source):
                begin = starts[place.lineno - 1] + place.col_offset
                end = starts[(place.end_lineno or 0) - 1] + (place.end_col_offset or 0)
                found.append(Mutant(file, lines, begin, end, raw[begin:end].decode(), text))
    return found


def _of_statement(statement: ast.stmt) -> list[ast.expr | ast.stmt]:
    """The statement and the expressions in it that are no annotation and in none of its inner statements."""
    annotation = getattr(statement, "annotation", None)
    heads = [child for child in ast.iter_child_nodes(statement) if isinstance(child, ast.expr)]
    inner = (node for head in heads if head is not annotation for node in ast.walk(head))
    return [statement, *(node for node in inner if isinstance(node, ast.expr))]


def pytest(root: Path, options: list[str], timeout_s: float | None) -> set[str] | None:
    """The tests that fail in the copy at ``root``; None when none does.

    A run that ends by a signal or after ``timeout_s`` has failed without a name.
    """
    command = [sys.executable, "-m", "pytest", "-q", "-rfE", "--tb=no", "-p", "no:cacheprovider", "-n", "0"]
    environment = os.environ | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        ran = subprocess.run(
            [*command, *options], cwd=root, env=environment, capture_output=True, text=True,
            timeout=timeout_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return set()
    if ran.returncode == 0:
        return None
    return set(re.findall(r"^(?:FAILED|ERROR) (\S+)", ran.stdout, re.MULTILINE))


def readers(root: Path, folder: Path, tests: list[str]) -> Callable[[Mutant], list[str]]:
    """Which tests come by a mistake; all where that is not seen (compiled, or read at import)."""
    broken = pytest(root, [f"--cov={folder}", "--cov-context=test", "--cov-report=", *tests], None)
    if broken is not None:
        raise SystemExit(f"without a mistake these fail: {', '.join(sorted(broken))}")
    data = CoverageData(str(root / ".coverage"))
    data.read()

    def of(mutant: Mutant) -> list[str]:
        contexts = data.contexts_by_lineno(str(root / mutant.file))
        names = {name.split("|")[0] for line in mutant.lines for name in contexts.get(line, [])}
        return sorted(names - {""}) or tests

    return of


def copy_of_sources(place: Path) -> None:
    """Every file of the repository at ``place``."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    for name in names.decode().split("\0"):
        if (ROOT / name).is_file():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, place / name)


def main() -> None:
    """Print every mistake that no test found, and how many were."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("tests", nargs="+")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="go on after the first failure: who finds what")
    request = parser.parse_args()
    files = sorted((ROOT / request.folder).rglob("*.py"))
    every = [mutant for file in files for mutant in mutants(file.relative_to(ROOT))]
    drawn = random.Random(request.seed).sample(every, min(request.count, len(every)))
    finders: Counter[str] = Counter()
    missed = []
    with tempfile.TemporaryDirectory() as copy, bars() as shown, shown.step(str(request.folder)) as bar:
        root = Path(copy).resolve()
        copy_of_sources(root)
        tests_of = readers(root, request.folder, request.tests)
        for number, mutant in enumerate(drawn, 1):
            file = root / mutant.file
            sound = file.read_bytes()
            file.write_bytes(sound[: mutant.begin] + mutant.text.encode() + sound[mutant.end :])
            found = pytest(root, [*([] if request.all else ["-x"]), *tests_of(mutant)], TIMEOUT_S)
            file.write_bytes(sound)
            finders.update(found or ())
            missed += [mutant] if found is None else []
            bar.update(number / len(drawn), f"{len(missed)} of {number} missed")
    print(f"{request.folder}, seed {request.seed}: {len(drawn) - len(missed)} of {len(drawn)} found")
    print(*[f"  missed {mutant}" for mutant in missed], sep="\n")
    print(*[f"  {count:3d} {name}" for name, count in finders.most_common()], sep="\n")


if __name__ == "__main__":
    main()
