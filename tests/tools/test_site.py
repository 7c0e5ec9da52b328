"""The site's own parts: references from code, and navigation."""

from pathlib import Path

import pytest

from testbed.scenarios import configuration_keys
from testbed.scenarios.scenario import MODELS
from tools.site import extension

ROOT = Path(__file__).parents[2]
YAML = """
# of the whole

gain: 2.5  # [M] beside
# above,
# and more
limits:
  low: -1.0  # [D]
  both: [1.0, 2.0]  # a list
"""
SCHEMA = {
    "properties": {
        "gain": {"type": "number", "exclusiveMinimum": 0, "maximum": 10},
        "mode": {"enum": ["a", "b"], "default": "a"},
        "limits": {"anyOf": [{"$ref": "#/$defs/Limits"}, {"type": "null"}]},
        "link": {"$ref": "#/$defs/Link", "default": {"port": 7}},
    },
    "$defs": {
        "Limits": {"properties": {"low": {"type": "number"}}},
        "Link": {"properties": {"port": {"type": "integer", "minimum": 1}}},
    },
}


def test_a_key_has_its_value_and_the_comments_above_and_beside(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(YAML, encoding="utf-8")
    assert [*configuration_keys.keys(tmp_path / "a.yaml")] == [
        ("gain", "2.5", "[M] beside"),
        ("limits.low", "-1.0", "[D]"),
        ("limits.both", "[1.0, 2.0]", "a list"),
    ]


@pytest.mark.parametrize(
    ("path", "told"),
    [("gain", "number, > 0, ≤ 10"), ("mode", "`a`, `b`"), ("limits.low", "number"), ("limits.none", "")],
)
def test_what_is_allowed_is_what_the_model_says(path: str, told: str) -> None:
    assert configuration_keys.allowed(SCHEMA, path) == told


def test_keys_that_the_file_leaves_out_are_there_with_what_they_then_are() -> None:
    assert dict(configuration_keys.left_out(SCHEMA, {"gain"})) == {"mode": '"a"', "link.port": "7"}
    assert dict(configuration_keys.left_out(SCHEMA, {"gain", "mode", "link.port"})) == {}


def test_every_shipped_key_is_known_to_its_model() -> None:
    for name, model in MODELS.items():
        schema = model.model_json_schema()
        written = [key.path for key in configuration_keys.keys(ROOT / "configs" / f"{name}.yaml")]
        assert written
        assert [path for path in written if not configuration_keys.allowed(schema, path)] == []


def test_every_page_is_in_the_navigation() -> None:
    listed = set(extension.by_reader(ROOT).split())
    pages = {
        f"/docs/{path.relative_to(ROOT / 'docs').with_suffix('')}" for path in (ROOT / "docs").rglob("*.md")
    }
    indexed = {page for page in pages if page.startswith("/docs/decisions/0")}
    assert pages - indexed - {"/docs/README"} - listed == set()
