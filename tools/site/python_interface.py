"""The Python interface from its docstrings: what autodoc is asked for."""

from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "longreach"


def modules() -> list[str]:
    """The package that users import, and its modules."""
    names = sorted(path.stem for path in PACKAGE.glob("*.py") if not path.stem.startswith("_"))
    return [PACKAGE.name, *(f"{PACKAGE.name}.{name}" for name in names)]


def page() -> str:
    """The reference of all of them, in their docstrings' order."""
    return "\n\n".join(
        f"## {name}\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n   :inherited-members:\n```"
        for name in modules()
    )
