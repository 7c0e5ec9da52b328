"""docs/glossary.md against the code: every identifier that it names exists."""

import ast
import re

import pytest

from tests.support.pages import page
from tests.support.paths import ROOT

NAMED = re.findall(r"`([a-z_]+/[\w/]+\.py)(?:: (\w+))?`", page("glossary.md"))


def test_the_glossary_names_files() -> None:
    assert len(NAMED) > 45


@pytest.mark.parametrize(("file", "name"), NAMED, ids=lambda value: value or "file")
def test_what_the_glossary_names_exists(file: str, name: str) -> None:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    defined = {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    defined |= {node.name for node in tree.body if isinstance(node, ast.AsyncFunctionDef)}
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        defined |= {target.id for target in targets if isinstance(target, ast.Name)}
    assert not name or name in defined
