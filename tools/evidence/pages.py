"""The pages with tables that are made of kept rows, and all those tables by name."""

from pathlib import Path

from tools.evidence import campaigns, real_machines, sight
from tools.evidence.kept_rows import RESULTS, ROOT, every_kept

PAGES = (ROOT / "README.md", *(ROOT / "docs" / name for name in ("evidence.md", "targets.md", "markers.md")))


def sections(results: Path = RESULTS) -> dict[str, str]:
    """Every generated section by its name."""
    kept = every_kept(results)
    return campaigns.sections(kept) | real_machines.sections(kept) | sight.sections(kept)
