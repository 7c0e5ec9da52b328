"""Every example with its picture and its text, in Markdown."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "python"
PICTURES = ROOT / "docs" / "images" / "examples"


def page() -> str:
    """The examples one below the other."""
    return "\n\n".join(_example(path) for path in sorted(EXAMPLES.glob("*.py")))


def _example(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    told = ast.get_docstring(ast.parse(text)) or ""
    title, _, rest = told.partition("\n")
    picture = PICTURES / f"{path.stem}.png"
    shown = f"![{title}](/docs/images/examples/{picture.name})\n\n" if picture.exists() else ""
    return f"## {path.name}\n\n{title}\n{rest}\n\n{shown}```python\n{text}```"
