"""The studio and what it runs on, fetched and checked: ``python -m tools.foxglove_studio.fetch DIR``."""

import shutil
import sys
import tempfile
from pathlib import Path

from tools.page_vendor import Package, unpack

_STUDIO = Package(
    "@foxglove/studio-base",
    "1.48.0",
    "EY8cYoHUm6VyTSVZBdfn5EJK2bRwTfAjH92H5wgAEcnKyeCUyKkxjgwbqO2jKwRJGa+7VPaEHHF167BzFh+N4A==",
    "MPL-2.0",
)
_REACT = Package(
    "react",
    "17.0.2",
    "gnhPt75i/dq/z3/6q/0asP78D0u592D5L1pd7M8P+dck6Fu/jJeL6iVVK23fptSUZj8Vjf++7wXA8UNclGQcbA==",
    "MIT",
)
_REACT_DOM = Package(
    "react-dom",
    "17.0.2",
    "s4h96KtLDUQlsENhMn1ar8t2bEa+q/YAtj8pPPdIjPDGBDIVNsrD9aXNWqspUe6AzKCIG0C1HZZLqLV7qpOBGA==",
    "MIT",
)
_PARTS = {"studio": (_STUDIO, "foxglove/package/assets"), "react": (_REACT, "react/package"),
          "react-dom": (_REACT_DOM, "react-dom/package")}  # fmt: skip


def fetch(target: Path) -> None:
    """Fill ``target``, which must not exist, with the folders that the page loads; nothing of theirs is run.

    Ends the process when a package has another hash than it should; CalledProcessError without npm's answer.
    """
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        whole = Path(scratch) / "whole"
        whole.mkdir()
        for name, (package, inside) in _PARTS.items():
            unpack(package, Path(scratch))
            shutil.move(Path(scratch) / inside, whole / name)
        whole.rename(target)


if __name__ == "__main__":
    fetch(Path(sys.argv[1]).resolve())
