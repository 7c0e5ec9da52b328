"""Our own coupler with one place of its source changed, and whether the coupler's suite notices.

``python -m tests.conformance.coupler.source_mutants`` changes each comparison, number, truth value, condition
and statement of what the coupler answers by, one at a time, asks every case and prints a line for each
module and each change that no case notices. Unlike the couplers broken by rule these were thought out by
nobody; some change nothing that a master could see, so somebody has to read what is left.
``--module NAME``: only that module.
"""

import argparse
import ast
import copy
import importlib
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from conformance.case import CaseOutcome
from conformance.runner import coupler_cases, run_coupler
from plant_emulator.shell.coupler import Coupler
from tests.conformance.coupler_mutant_report import shifted_clock
from tests.conformance.couplers import RELEASE_NS, ThreadedCoupler

MODULES = (
    "foundation.modbus",
    "plant_emulator.core.coupler.modbus_requests",
    "plant_emulator.core.coupler.watchdog",
    "plant_emulator.core.coupler.image",
    "plant_emulator.core.coupler.answers",
    "plant_emulator.shell.modbus_pdus",
)
AROUND = ("plant_emulator.shell.coupler_connection", "plant_emulator.shell.coupler")  # imported anew too
_OTHER_COMPARISON: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip


class Change(NamedTuple):
    """One changed place: the module, its line, what was there and what is there now."""

    module: str
    line: int
    what: str
    tree: ast.Module


def changes(module: str) -> Iterator[Change]:
    """Every change of a module."""
    tree = ast.parse(Path(*module.split(".")).with_suffix(".py").read_text())
    nodes = list(ast.walk(tree))
    for at, node in enumerate(nodes):
        for number in range(_count(node)):
            changed = copy.deepcopy(tree)
            twin = list(ast.walk(changed))[at]
            before = ast.unparse(node)
            _change(twin, number)
            after = ast.unparse(twin)
            if after != before:
                what, line = f"{_first_line(before)}  ->  {_first_line(after)}", getattr(node, "lineno", 0)
                if isinstance(node, ast.FunctionDef):
                    dropped = node.body[number + 1]
                    what, line = f"without: {_first_line(ast.unparse(dropped))}", dropped.lineno
                yield Change(module, line, what, ast.fix_missing_locations(changed))


def _first_line(text: str) -> str:
    return text.split("\n")[0][:70]


def _count(node: ast.AST) -> int:
    """In how many ways a node is changed."""
    if isinstance(node, ast.Compare):
        return len(node.ops)
    if isinstance(node, ast.Constant):
        return 2 if type(node.value) is int else 1 if type(node.value) is bool else 0
    if isinstance(node, ast.If | ast.IfExp):
        return 2
    if isinstance(node, ast.FunctionDef):
        return len(node.body) - 1
    unpacks = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple)
    return int(unpacks or isinstance(node, ast.BoolOp))


def _change(node: Any, number: int) -> None:
    if isinstance(node, ast.Compare):
        node.ops[number] = _OTHER_COMPARISON[type(node.ops[number])]()
    elif isinstance(node, ast.Constant):
        node.value = not node.value if type(node.value) is bool else node.value + (1, -1)[number]
    elif isinstance(node, ast.If | ast.IfExp):
        node.test = ast.Constant(bool(number))
    elif isinstance(node, ast.BoolOp):
        node.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
    elif isinstance(node, ast.FunctionDef):
        dropped = node.body[number + 1]
        if isinstance(dropped, ast.Expr | ast.AugAssign | ast.If):
            node.body[number + 1] = ast.copy_location(ast.Pass(), dropped)
    elif isinstance(node.value, ast.Tuple):
        node.value.elts = [*node.value.elts[1:], node.value.elts[0]]


def built(change: Change) -> type[Coupler]:
    """The coupler's class with ``change`` in it. Raises what a module raises that cannot even begin."""
    names = [*MODULES, *AROUND]
    kept = {name: sys.modules.pop(name) for name in names if name in sys.modules}
    try:
        for name in names:
            if name == change.module:
                module = ModuleType(name)
                sys.modules[name] = module
                exec(compile(change.tree, name, "exec"), vars(module))
            else:
                importlib.import_module(name)
        return sys.modules[AROUND[1]].Coupler  # type: ignore[no-any-return]
    finally:
        for name in names:
            sys.modules.pop(name, None)
        sys.modules.update(kept)


def noticed(change: Change) -> int:
    """The case that notices the change, 0 for none, -1 where the changed module cannot even begin."""
    try:
        kind = built(change)
    except Exception:
        return -1

    class Changed(ThreadedCoupler):
        """Our coupler with the change."""

        def make(self) -> Coupler:
            return kind(self.sensors, self.take, RELEASE_NS, self.clock_ns())

    for case in coupler_cases():
        with Changed() as coupler:
            summary = run_coupler("127.0.0.1", coupler.port, numbers=[case.number], outputs=True)
        # No result: the runner's look before the first case found nobody to ask.
        if not summary.results or summary.results[0].outcome is not CaseOutcome.PASS:
            return case.number
    return 0


def main() -> None:
    """Ask and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--module", choices=MODULES)
    only = parser.parse_args().module
    counts: Counter[tuple[str, str]] = Counter()
    with shifted_clock() as clock:
        ThreadedCoupler.clock = clock
        for module in MODULES if only is None else (only,):
            for change in changes(module):
                case = noticed(change)
                counts[module, "noticed" if case > 0 else "not noticed" if case == 0 else "no module"] += 1
                print(f"{case:>4} {module}:{change.line}  {change.what}", file=sys.stderr, flush=True)
                if case == 0:
                    print(f"not noticed: {module}:{change.line}  {change.what}", flush=True)
    for (module, outcome), count in sorted(counts.items()):
        print(f"{module:>44} {outcome:>12} {count:>5}")


if __name__ == "__main__":
    main()
