"""Where the project's files lie, for every test: one place, so that a test may change its room."""

import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
DOCS = ROOT / "docs"


def copied_configs(to: Path) -> Path:
    """A copy of the configuration files at ``to`` that may be written, also where the checkout may not."""
    shutil.copytree(CONFIGS, to, copy_function=shutil.copyfile)
    for place in (to, *to.rglob("*")):
        if place.is_dir():
            place.chmod(0o755)
    return to
