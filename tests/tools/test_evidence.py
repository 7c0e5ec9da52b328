"""How old the rows of the page on evidence are, and that none was tuned on."""

import pytest

from tools.evidence import PAGE, rows_of, tuned_seeds

TABLE = """
| what | command: `longreach experiment …` | runs | found | |
|---|---|---|---|---|
| one | `positioning --method programs --count 20 --seed 46801` | 20 | 1.72 mm | met |
| two | the same | 20 | 1.56 mm | met |
| holes | `targets --method hole-drives --seed 45970` | 1 | 0.58 mm | met |

| other | table |
|---|---|
| 1 | `targets --seed 3` |
"""


def test_rows_have_their_module_and_seeds_and_the_same_means_the_row_before() -> None:
    one, two, holes = rows_of(TABLE)
    assert one.module == "laboratory.experiments.positioning.programs"
    assert (one.seeds, one.numbers) == (range(46801, 46821), "1.72 mm")
    assert (two.module, two.seeds, two.numbers) == (one.module, one.seeds, "1.56 mm")
    assert (holes.module, holes.seeds) == (
        "laboratory.experiments.targets.hole_drives",
        range(45970, 45971),
    )


def test_seeds_of_numbers_in_configs_are_known_by_their_comments() -> None:
    tuned = tuned_seeds()
    assert "calm_ms" in tuned[8501]
    assert "settle_timeout_s" in tuned[8407]
    assert 72101 not in tuned


@pytest.mark.parametrize("row", list(rows_of(PAGE.read_text(encoding="utf-8"))), ids=lambda row: row.what)
def test_no_row_of_the_page_has_seeds_that_a_number_was_taken_from(row: object) -> None:
    assert row.module  # type: ignore[attr-defined]
    assert not {*row.seeds} & {*tuned_seeds()}  # type: ignore[attr-defined]
