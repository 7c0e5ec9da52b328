"""Rows of the real worlds are counted together over campaigns, and judged by what is asked."""

from collections.abc import Sequence

import pytest

from testbed.campaigns.typed_rows import XYZ, flat
from testbed.experiments.positioning.corrected_run import Branch, PositioningRow
from testbed.experiments.positioning.told import Told
from tools.evidence.kept_rows import Kept
from tools.evidence.real_machines import sections

BEST_MODE, EYES_AGREE = "longreach experiment best-mode", "longreach experiment eyes-agree"


def _run(seed: int, error_mm: float, probability: float = 0.99) -> PositioningRow:
    """A run of which the spread told is the spread, but for 1 in 16 beyond the 95 % ellipse."""
    distance2 = 8.0 if seed % 16 == 0 else 1.6
    before = Told(probability, 0.0, 0.0, 1.0, 1.0, 0.0, distance2=distance2, level2=5.99)
    end = Branch(XYZ(error_mm, 0.0, 0.0), std_mm=XYZ(1.0, 1.0, 1.0), worst_mm=error_mm, before=before)
    return PositioningRow(seed, "plant", 0.0, 0.0, 0.0, 0.0, 0.0, "real", one_shot=end, look1=end, look2=end)


def _kept(command: str, runs: Sequence[PositioningRow], eyes: str = "") -> Kept:
    seen = {"eyes": eyes, "cpu_s": 1.0} if eyes else {}
    return Kept("name", command, "abc1234", [flat(run) | seen for run in runs])


def _lines(kept: Sequence[Kept], section: str) -> list[list[str]]:
    made = sections(kept)[section].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in made]


def test_campaigns_of_a_machine_are_counted_together() -> None:
    kept = [_kept(BEST_MODE, [_run(seed, 1.0) for seed in range(first, first + 100)]) for first in (0, 100)]
    one, two = _lines(kept, "real machines")
    assert one[:7] == ["4 m arm", "model", "one look", "200", "200", "1.00, 1.00, 1.00", "0"]
    assert one[-1] == two[-1] == "yes"
    assert _lines(kept[:1], "real machines")[0][-1] == "too few"


@pytest.mark.parametrize(
    ("probability", "missed"), [(0.99, "NO: silent misses"), (0.5, "yes")], ids=["silent", "told"]
)
def test_one_silent_miss_is_one_too_many(probability: float, missed: str) -> None:
    runs = [_run(seed, 1.0) for seed in range(1, 200)] + [_run(200, 9.0, probability)]
    assert _lines([_kept(BEST_MODE, runs)], "real machines")[0][-1] == missed


def test_pictures_are_compared_with_the_model_in_pairs_over_campaigns() -> None:
    errors = [0.5, 0.8, 1.0, 1.3]
    kept = []
    for first in (0, 10):
        runs = [_run(first + n, error) for n, error in enumerate(errors)]
        half = [_run(first + n, error / 2.0) for n, error in enumerate(errors)]
        kept += [_kept(EYES_AGREE, runs, "pixels"), _kept(EYES_AGREE, half, "model")]
    for line in _lines(kept, "pictures and model"):
        assert line[2] == "8"
        assert line[4] == "2.00, 2.00 to 2.00"
        assert line[-1] == "NO"
    assert [line[1] for line in _lines(kept, "real machines")] == ["model"] * 2 + ["pictures"] * 2


def test_what_was_told_stands_beside_how_often_it_came_true() -> None:
    runs = [_run(1, 1.0, 0.7), _run(2, 9.0, 0.7), _run(3, 1.0, 0.995)]
    lines = _lines([_kept(BEST_MODE, runs)], "told probabilities")
    assert lines == [
        ["4 m arm", "0.5 to 0.8", "6", "0.700", "0.500"],
        ["4 m arm", "0.99 to 0.999", "3", "0.995", "1.000"],
    ]


def test_rows_of_other_worlds_are_not_counted() -> None:
    lab = [_run(1, 1.0)._replace(world="lab")]
    assert not _lines([_kept(BEST_MODE, lab)], "real machines")
