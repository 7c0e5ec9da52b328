"""Targets over the REST face, in process."""

import pytest

from tests.vision_pc.synthetic_station import Bench

pytestmark = pytest.mark.realtime


async def test_a_click_makes_a_target_that_is_aimed_at_and_can_be_forgotten(station: Bench) -> None:
    made = await station.post("/targets", {"u_px": 812.4, "v_px": 301.0, "frame_id": 4711})
    assert made.status_code == 201, made.text
    assert made.headers["Location"] == "/targets/t1"
    document = made.json()
    assert document["recognised"] == "hole 45.0 mm"
    assert document["aimed"] is True
    assert document["std_mm"]["x"] == pytest.approx(1.0)
    assert document["std_sight_mm"] == {"across": 1.0, "along": 1.0}
    listed = (await station.client.get("/targets", params={"detect": True})).json()
    assert [target["id"] for target in listed["targets"]] == ["t1"]
    assert listed["holes"][0]["diameter_mm"] == 45.0
    second = await station.post("/targets", {"u_px": 1.0, "v_px": 1.0})
    assert second.status_code == 201, second.text
    aimed = await station.post("/targets/t1/aim")
    assert aimed.json()["aimed"] is True
    other = (await station.client.get(second.headers["Location"])).json()
    assert other["aimed"] is False
    assert (await station.client.delete("/targets/t1")).status_code == 204
    assert (await station.client.get("/targets/t1")).status_code == 404
    assert station.events("target_made")


async def test_what_cannot_be_told_is_a_problem_with_its_cause_and_candidates(station: Bench) -> None:
    answer = await station.post("/targets", {"u_px": -5.0, "v_px": 3.0})
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["cause"] == "target.ambiguous"
    assert answer.json()["candidates"] == [
        {"other_px": [5.0, 6.0], "p_C_m": [0.1, 0.2, 1.0], "distance_mm": 1024.7}
    ]
    old = await station.post("/targets", {"u_px": 5.0, "v_px": 3.0, "frame_id": 1})
    assert old.json()["cause"] == "target.frame_too_old"
    assert (await station.post("/targets", {"u_px": 5.0})).status_code == 422
    assert (await station.client.get("/targets")).json() == {"targets": []}


@pytest.mark.parametrize(
    ("half", "words"),
    [
        ({"other_u_px": 4.0}, "give both, or none"),
    ],
)
async def test_half_a_wish_is_refused_in_words_and_not_left_out(
    station: Bench, half: dict[str, float], words: str
) -> None:
    answer = await station.post("/targets", {"u_px": 5.0, "v_px": 3.0} | half)
    assert answer.status_code == 422
    assert words in answer.json()["detail"]


@pytest.mark.slow("motions in real time")
@pytest.mark.parametrize(
    ("program", "more"),
    [
        ("orientation-adjustment", {}),
        ("look-then-move", {"method": "paper"}),
        ("looking-and-moving", {"timeout_s": 0.3}),  # this bench's pictures do not follow its arm
    ],
)
async def test_who_names_a_target_drives_to_it_whatever_another_has_clicked_since(
    station: Bench, program: str, more: dict[str, float]
) -> None:
    await station.post("/enable")
    await station.succeeded("trajectory-matching")
    for _ in range(2):
        await station.post("/targets", {"u_px": 5.0, "v_px": 3.0})
    for named, aimed in (("t1", "t1"), ("markers", None), ("t2", "t2")):
        await station.post("/enable")  # servoing that fails leaves this arm disabled
        await station.run(program, {"target": named} | more)
        kept = station.eyes.targets.aimed
        assert (None if kept is None else kept.id) == aimed
    await station.post("/enable")
    refused = await station.post(f"/operations/{program}", {"target": "t9"} | more)
    assert (refused.status_code, refused.json()["cause"]) == (404, "refused.unknown_target")


async def test_programs_refuse_a_target_that_is_not_there(station: Bench) -> None:
    await station.post("/enable")
    await station.succeeded("local-track")
    request = {"method": "corrected", "target": "t9"}
    answer = await station.post("/operations/look-then-move", request)
    assert answer.status_code == 404
    assert answer.json()["cause"] == "refused.unknown_target"
    assert (await station.post("/operations/visit", {"targets": ["t9"]})).status_code == 404
    assert (await station.post("/operations/visit", {"targets": []})).status_code == 422


@pytest.mark.slow("motions in real time")
async def test_a_row_of_targets_is_visited_with_one_track(station: Bench) -> None:
    await station.post("/enable")
    for _ in range(2):
        await station.post("/targets", {"u_px": 5.0, "v_px": 3.0})
    ended = await station.succeeded("visit", {"targets": ["t1", "t2"]})
    assert [each["calibrated"] for each in ended["result"]["targets"]] == [True, False]
    assert [each["target"] for each in ended["result"]["targets"]] == ["t1", "t2"]
