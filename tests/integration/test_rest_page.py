"""The blocks of pages that ask running services, as they stand, against `longreach up`."""

from pathlib import Path

import pytest

from tests.support.page_runner import API, documents, judge_rest_block, pasted, refusals, shell_blocks, up

pytestmark = [pytest.mark.processes, pytest.mark.slow("minutes of motions"), pytest.mark.timeout(1800)]

FAULTS = "http://127.0.0.1:8010"
WITHIN_S = 1500.0


def test_the_blocks_of_rest_and_faults_work_against_up(tmp_path: Path) -> None:
    """And what the first of them leaves behind is a machine that takes the other's faults."""
    nowhere = {"COMPOSE_FILE": str(tmp_path / "none.yml")}  # no containers: there is no token
    ((rest_block,), (fault_block,)) = shell_blocks("rest.md"), shell_blocks("faults.md")
    assert API in rest_block
    assert FAULTS in fault_block
    with up(tmp_path) as (rest, faults):
        judge_rest_block(pasted(rest_block, rest, tmp_path, nowhere, "docker compose", WITHIN_S), tmp_path)
        block = fault_block.replace(FAULTS, faults)
        ordered, state, mended = documents(pasted(block, rest, tmp_path, {}, "docker compose", 60.0))
    assert (ordered["number"], ordered["fault"]["kind"]) == (1, "valve_slow")
    assert [each["number"] for each in (*state["active"], *state["planned"], mended)] == [1, 1]


def test_the_block_of_targets_drives_to_a_hole(tmp_path: Path) -> None:
    with up(tmp_path, "--scenario", "drill_face") as (rest, _):
        block = shell_blocks("targets.md")[1]
        assert API in block
        answers = documents(pasted(block, rest, tmp_path, {}, "docker compose", WITHIN_S))
    assert not refusals(answers), refusals(answers)
    kept, _, _, driven, visited, *_ = answers
    assert (kept["id"], kept["kind"]) == ("t1", "hole")
    assert driven["result"]["verdict"] == visited["result"]["targets"][0]["verdict"] == "inside"
