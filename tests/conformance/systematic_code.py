"""The controller's own code of the link, changed at one place each: as a tired programmer would have it.

In a fresh copy of the modules below one comparison is turned or shifted, one condition or part of it left
out, one number is one more or less, one sum a difference, or one statement is missing that keeps or counts
something. Nobody else sees the copy: the suite goes on with the code as it is. Many of the changes cannot be
told from outside, so this table is no part of the test; ``python -m tests.conformance.mutant_report --source
tests.conformance.systematic_code`` asks it, and what no case catches is where to look for the next one.
"""

import ast
import copy
import importlib
import sys
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

from controller.core.inbox import Inbox
from protocol.authentication import LinkKey
from protocol.server_session import ReferenceServer
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.key import KEY
from tests.support.paths import ROOT

# In the order in which they need one another; only the named functions and classes are changed.
MODULES = (
    "protocol.authentication", "protocol.datagram", "protocol.channel", "protocol.command_ledger",
    "protocol.session_factory", "protocol.server_session", "controller.core.inbox",
)  # fmt: skip
# What a controller does not use, or what only says why.
LEFT_OUT = {
    "protocol.authentication": {"of_client", "__init__"},
    "protocol.datagram": {"encode", "_flattened", "_flatten_waypoints", "_bad_value"},
    "protocol.channel": {"dropped"},
}
CLAUSES = {
    "protocol.authentication": "11.5", "protocol.datagram": "3.5", "protocol.channel": "5.2",
    "protocol.command_ledger": "6.2", "protocol.session_factory": "4.2", "protocol.server_session": "4.9",
    "controller.core.inbox": "6.14",
}  # fmt: skip
_TURNED: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
_OTHER: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.FloorDiv: ast.Mult,
}  # fmt: skip


class _Changing(ast.NodeTransformer):
    """Counts the places that can be changed; changes the ``wanted`` one and says what it was."""

    def __init__(self, wanted: int, left_out: set[str]) -> None:
        self.wanted, self.left_out = wanted, left_out
        self.count = 0
        self.what = ""

    def _here(self, node: ast.AST, what: str) -> bool:
        self.count += 1
        if self.count - 1 != self.wanted:
            return False
        self.what = f"{getattr(node, 'lineno', 0)}: {what}"
        return True

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        if node.name in self.left_out:
            return node
        body = node.body[1:] if ast.get_docstring(node) else node.body
        node.body = [*node.body[: len(node.body) - len(body)], *self._block(body)]
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        if node.name in self.left_out:
            return node
        node.body = [self.visit(each) if isinstance(each, ast.FunctionDef) else each for each in node.body]
        return node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return node

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return node

    def visit_Assert(self, node: ast.Assert) -> ast.AST:
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def _block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        kept: list[ast.stmt] = []
        for each in statements:
            alone = isinstance(each, ast.Expr) and isinstance(each.value, ast.Call)
            stores = isinstance(each, ast.AugAssign) or (
                isinstance(each, ast.Assign) and isinstance(each.targets[0], ast.Attribute | ast.Subscript)
            )
            if (alone or stores or isinstance(each, ast.Raise)) and self._here(
                each, f"no {ast.unparse(each)}"
            ):
                kept.append(ast.Pass())
                continue
            if isinstance(each, ast.If | ast.For | ast.While | ast.With | ast.Try):
                self._blocks_of(each)
                kept.append(each)
                continue
            kept.append(self.visit(each))
        return kept

    def _blocks_of(self, statement: ast.stmt) -> None:
        for part in ("body", "orelse", "finalbody"):
            if getattr(statement, part, None):
                setattr(statement, part, self._block(getattr(statement, part)))
        for handler in getattr(statement, "handlers", []):
            handler.body = self._block(handler.body)
        if isinstance(statement, ast.If):
            statement.test = self._condition(statement.test)

    def _condition(self, test: ast.expr) -> ast.expr:
        for value in (True, False):
            if self._here(test, f"if {value} for if {ast.unparse(test)}"):
                return ast.copy_location(ast.Constant(value), test)
        return self.visit(test)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        for i, op in enumerate(node.ops):
            for other in _TURNED[type(op)]:
                if self._here(node, f"{other.__name__} in {ast.unparse(node)}"):
                    node.ops[i] = other()
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        for i, part in enumerate(node.values):
            if self._here(node, f"{ast.unparse(node)} without {ast.unparse(part)}"):
                rest = node.values[:i] + node.values[i + 1 :]
                return rest[0] if len(rest) == 1 else ast.copy_location(ast.BoolOp(node.op, rest), node)
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.Not) and self._here(node, f"{ast.unparse(node)} without not"):
            return node.operand
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        other = _OTHER.get(type(node.op))
        if other is not None and self._here(node, f"{other.__name__} in {ast.unparse(node)}"):
            node.op = other()
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, bool) or node.value is None:
            return node
        if isinstance(node.value, int):
            for step in (1, -1):
                if self._here(node, f"{node.value + step} for {node.value}"):
                    return ast.copy_location(ast.Constant(node.value + step), node)
        return node


@cache
def _tree(module: str) -> ast.Module:
    return ast.parse((ROOT / Path(*module.split("."))).with_suffix(".py").read_text())


def _changed(module: str, wanted: int) -> tuple[ast.Module, _Changing]:
    tree = copy.deepcopy(_tree(module))
    changing = _Changing(wanted, LEFT_OUT.get(module, set()))
    tree.body = [
        changing.visit(node) if isinstance(node, ast.FunctionDef | ast.ClassDef) else node
        for node in tree.body
    ]
    return ast.fix_missing_locations(tree), changing


def _copies(module: str, wanted: int) -> dict[str, ModuleType]:
    """Fresh copies of all MODULES, of which ``module`` is changed at its place ``wanted``."""
    originals = {name: importlib.import_module(name) for name in MODULES}
    copies: dict[str, ModuleType] = {}
    try:
        for name in MODULES:
            tree = _changed(name, wanted)[0] if name == module else _tree(name)
            fresh = ModuleType(name)
            fresh.__file__ = originals[name].__file__
            sys.modules[name] = copies[name] = fresh
            exec(compile(tree, str(fresh.__file__), "exec"), fresh.__dict__)
    finally:
        sys.modules.update(originals)
    return copies


class _Copied(ControllerUnderTest):
    """A controller whose code of the link is a changed copy."""

    def __init__(self, module: str, wanted: int, key: LinkKey | None) -> None:
        copies = _copies(module, wanted)
        self._server_class: Any = copies["protocol.server_session"].ReferenceServer
        self._inbox_class: Any = copies["controller.core.inbox"].Inbox
        # The key, too, is made by the changed copy.
        self.link_key = copies["protocol.authentication"].LinkKey(bytes(range(32))) if key else None
        super().__init__()

    def make_server(self) -> ReferenceServer:
        server: ReferenceServer = self._server_class(
            77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, key=self.link_key
        )
        return server

    def make_inbox(self) -> Inbox:
        inbox: Inbox = self._inbox_class()
        return inbox


def _rows() -> Iterator[BrokenController]:
    for module in MODULES:
        _, counted = _changed(module, -1)
        for place in range(counted.count):
            what = _changed(module, place)[1].what
            name = f"{module}:{what}"
            key = KEY if module == "protocol.authentication" else None
            make = partial(_Copied, module, place, key)
            yield BrokenController(name, CLAUSES[module], make, key)


MUTANTS = tuple(_rows())
