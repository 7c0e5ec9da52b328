"""The libraries that our pages carry are those that their page says, unchanged, with licence and recipe."""

import hashlib
import re

import pytest

from tools.page_vendor import FILES, PACKAGES, Made


@pytest.mark.parametrize("made", FILES, ids=lambda made: made.name)
def test_a_file_is_what_its_page_says(made: Made) -> None:
    told = (made.folder / "THIRD_PARTY.md").read_text(encoding="utf-8")
    wanted = rf"^\| {re.escape(made.name)} \| (\S+) (\S+) \| (\S+) \| ([0-9a-f]{{64}}) \|$"
    row = re.search(wanted, told, re.MULTILINE)
    assert row is not None
    package = PACKAGES[made.package]
    assert row.groups()[:3] == (package.name, package.version, package.licence)
    assert hashlib.sha256((made.folder / made.name).read_bytes()).hexdigest() == row[4]
    assert f"## {package.name}\n\n```" in told  # the licence's text


def test_every_file_of_a_vendor_folder_is_made_by_the_recipe() -> None:
    for folder in {made.folder for made in FILES}:
        made = {each.name for each in FILES if each.folder == folder}
        assert {path.name for path in folder.iterdir()} == made | {"THIRD_PARTY.md"}
