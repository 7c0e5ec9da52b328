"""docs/glossary.md against the code: every identifier that it names exists."""

import ast
import re

from tests.support.pages import page
from tests.support.paths import ROOT

NAMED = re.findall(r"`([a-z_]+/[\w/]+\.py)(?:: (\w+))?`", page("glossary.md"))


def test_what_the_glossary_names_exists() -> None:
    assert len(NAMED) > 45
    assert [(file, name) for file, name in NAMED if name not in {"", *_defined(file)}] == []


def _defined(file: str) -> set[str]:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    defined = {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    defined |= {node.name for node in tree.body if isinstance(node, ast.AsyncFunctionDef)}
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        defined |= {target.id for target in targets if isinstance(target, ast.Name)}
    return defined
