"""The animation of a run: its pictures are of the run, and the one that is shown is small."""

import itertools
from pathlib import Path
from unittest.mock import patch

import pytest
from PIL import Image

from testbed.pictures.film import filmed, write_film
from testbed.reporting.console import bars
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS, ROOT

EVERY_NS = 400_000_000
SHOWN = ROOT / "docs" / "images" / "run.webp"


def only_a_look(rig: object, recorder: object, looks: int) -> None:
    recorder.step("start", "look", {})  # type: ignore[attr-defined]


@pytest.mark.slow("a run is filmed")
def test_a_run_becomes_an_animation(tmp_path: Path) -> None:
    settings = load_settings(CONFIGS, {})
    often = patch("testbed.pictures.film.EVERY_NS", EVERY_NS)
    with often, patch("testbed.pictures.film.demonstrate", only_a_look), bars(quiet=True) as shown:
        stills, rests = filmed(settings, 1, 0, shown)
    assert [rest.label for rest in rests] == ["start"]
    times = [still.truth.time_ns for still in stills]
    assert len(times) >= 2
    assert {b - a for a, b in itertools.pairwise(times)} == {EVERY_NS}
    assert stills[0].picture.std() > 5.0  # grey levels: something is seen
    write_film(settings, stills, rests, tmp_path / "run.webp")
    with Image.open(tmp_path / "run.webp") as film:
        assert film.n_frames == len(stills)


def test_the_one_on_the_first_page_is_small() -> None:
    assert SHOWN.stat().st_size <= 1_500_000
    with Image.open(SHOWN) as film:
        assert film.n_frames > 30
        film.seek(film.n_frames - 1)
        assert film.convert("L").getextrema()[0] < 50
