"""Where the project's files lie, for every test: one place, so that a test may change its room."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
DOCS = ROOT / "docs"
