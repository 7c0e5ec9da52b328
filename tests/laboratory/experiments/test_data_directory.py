"""Recordings of others are looked for beside the project, wherever the module that looks lies in it."""

import re
from pathlib import Path

import pytest

from laboratory.experiments.hand_eye import real_sets
from protocol.errors import RequestRefused
from tests.support.paths import CONFIGS


def test_the_recordings_lie_beside_the_project(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LONGREACH_DATA", raising=False)
    beside = CONFIGS.resolve().parents[1] / "shared" / "data"
    monkeypatch.setattr(Path, "is_dir", lambda _path: False)  # the refusal says where it looked
    with pytest.raises(RequestRefused, match=re.escape(f"{beside};")):
        real_sets.data_directory()


def test_the_environment_names_another_place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LONGREACH_DATA", str(tmp_path))
    assert real_sets.data_directory() == tmp_path
