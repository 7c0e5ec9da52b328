"""How Sphinx makes the pages of this repository into a site: ``make docs``. The pages stay as they are."""

import importlib.metadata
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

project = "Longreach"
author = "the Longreach authors"
version = release = importlib.metadata.version("longreach")
extensions = ["myst_parser", "tools.site.extension"]

root_doc = (
    "README"  # the source directory is the repository, so that links between pages are those of the forge
)
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "RELEASING.md",
    "SECURITY.md",
    "docs/**.md",
    "examples/*/README.md",
]
exclude_patterns = []
suppress_warnings = ["toc.multiple_toc_parents"]

myst_heading_anchors = 4  # as the forge makes them
myst_links_external_new_tab = False

html_theme = "furo"
html_title = f"Longreach {version}"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_additional_pages = {"index": "to_the_first_page.html"}
templates_path = ["site_templates"]
html_copy_source = False
html_show_sphinx = False
html_permalinks_icon = "#"
