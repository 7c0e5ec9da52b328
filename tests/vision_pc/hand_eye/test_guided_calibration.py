"""The guided session step by step, on the emulator's pictures and an arm that is always where it was told."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest

from protocol.errors import MeasurementFailed, RequestRefused
from protocol.faults import FaultCode, GroupState
from testbed.hand_eye import session_text
from testbed.hand_eye.importer import load
from tests.vision_pc.hand_eye.still_rig import StillRig, quiet, still_settings
from tests.vision_pc.program_settings import BOOM
from vision_pc.application.application import VisionApplication
from vision_pc.application.hand_eye.responses import session_json
from vision_pc.application.ports import CameraStatus
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import solution as guided_solution
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.shell.rest.api import create_app
from vision_pc.shell.rest.operations import Operations

QUICK = {"vision": {"hand_eye": {"frames": 1, "minimum_frames": 1, "poses": 6, "candidates": 300}}}


def quick_rig(sessions: Path, robot_m: float = 0.0, robot_rad: float = 0.0, **overrides: Any) -> StillRig:
    """A rig whose samples take one picture, in a session of six."""
    return StillRig(still_settings(**(QUICK | overrides)), sessions, robot_m, robot_rad)


async def begun(rig: StillRig, name: str = "monday") -> None:
    """A session with its first sample."""
    await rig.guided.start(name, rig.guided.defaults, 1, quiet)
    await rig.guided.sample(quiet)


@pytest.mark.slow("a whole session")
async def test_a_whole_session_finds_the_camera_in_the_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = quick_rig(tmp_path, robot_m=0.0003, robot_rad=0.0003)
    check = await rig.guided.start("monday", rig.guided.defaults, 1, quiet)
    assert check["verdict"] == "marker 582 seen, 0/6: ready"
    await rig.guided.sample(quiet)
    stds = []
    while not rig.guided.session.complete:
        proposal = await rig.guided.next_pose(quiet)
        done = await rig.guided.sample(quiet)
        seen_at = np.array(rig.guided.session.samples[-1].corners_left).mean(axis=0)
        if len(stds) > 2:  # once X is known roughly, the marker is where it was expected
            assert np.abs(seen_at - proposal["pixel"]).max() < 25.0
        stds.append(done["std_mm"])
    assert stds == sorted(stds, reverse=True)
    answer = await rig.guided.solve()
    assert answer["certificate"]["holds"]
    assert answer["left_out"] == []
    assert np.all(np.array(answer["with_arm"]["std_mm"]) > answer["std_mm"])
    assert session_text.solved(answer, None) == answer["good"]
    printed = " ".join(capsys.readouterr().out.split())
    zeros = zip(answer["arm"]["zeros_mrad"], answer["arm"]["std_mrad"], strict=True)
    assert ", ".join(f"{zero:+.1f} ± {std:.1f}" for zero, std in zeros) + " mrad" in printed
    X = guided_solution.solve(rig.guided.session).result.X
    assert np.allclose(answer["X_TC"]["p_m"], X[:3, 3])
    off = se3.local(X, rig.X_TC)
    assert 1e3 * np.linalg.norm(off[:3]) < 3.0
    assert np.degrees(np.linalg.norm(off[3:])) < 0.25


async def test_samples_are_removed_and_resumed_from_the_disk(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    await begun(rig)
    for _ in range(2):
        await rig.guided.next_pose(quiet)
        await rig.guided.sample(quiet)
    assert [s.name for s in rig.guided.remove("1").samples] == ["2", "3"]
    before = session_json(rig.guided.session)

    again = quick_rig(tmp_path)
    assert again.guided.store.names() == ["monday"]
    assert session_json(again.guided.resume("monday")) == before
    assert (await again.guided.sample(quiet))["sample"] == "4"
    assert [s.name for s in again.guided.session.samples] == ["2", "3", "4"]


async def test_a_session_is_exported_for_the_file_solver(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    await begun(rig)
    for _ in range(4):
        await rig.guided.next_pose(quiet)
        await rig.guided.sample(quiet)
    session_text.exported(tmp_path / "monday.json", tmp_path / "samples.json")
    from_file = methods.solve(load(tmp_path / "samples.json"))
    assert np.allclose(from_file.X, methods.solve(rig.guided.session.pairs()).X, atol=1e-9)


async def test_refused_poses_are_remembered_and_others_are_found(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    start = rig.X_BT
    await begun(rig)
    rig.refuse = lambda X: (
        "joint_limit" if (start[:3, :3].T @ X[:3, :3])[1, 0] > 0.1 else None
    )  # one roll only
    await rig.guided.next_pose(quiet)
    rig.refuse = lambda X: "too_far" if len(rig.guided.session.refused) == refused else "stopped"
    moves, refused = len(rig.moves), len(rig.guided.session.refused)
    with pytest.raises(RequestRefused) as told:
        await rig.guided.next_pose(quiet)
    assert told.value.cause == "refused.stopped"  # is no reason to try another
    assert len(rig.moves) == moves
    assert len(rig.guided.session.refused) == refused + 1


async def test_an_arm_stuck_in_a_corner_goes_back_to_the_start(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    start = rig.X_BT
    await begun(rig)
    await rig.guided.next_pose(quiet)
    await rig.guided.sample(quiet)
    corner = rig.X_BT
    rig.refuse = lambda X: "singular" if rig.X_BT is corner and not np.array_equal(X, start) else None
    await rig.guided.next_pose(quiet)
    assert np.array_equal(rig.moves[-2], start)
    assert len(rig.guided.session.refused) == 6

    rig.refuse = lambda X: "joint_limit" if np.array_equal(X, start) and rig.X_BT is not corner else None
    back = await rig.guided.back(quiet)  # the straight way is refused: over the sample
    assert back["off"] == {"mm": 0.0, "deg": 0.0}
    assert np.array_equal(rig.moves[-2], corner)


async def test_after_a_fault_nothing_more_is_tried_and_the_pose_is_not_proposed_again(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    await begun(rig)
    rig.refuse = lambda X: "fault_joint_limit"
    with pytest.raises(RequestRefused) as refused:
        await rig.guided.next_pose(quiet)
    assert refused.value.cause == "refused.fault_joint_limit"
    assert len(rig.guided.session.refused) == 1


async def test_an_arm_that_moves_on_spoils_the_sample(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    await begun(rig)
    rig.settled, rig.drift_mrad = False, 3.0
    with pytest.raises(MeasurementFailed) as refused:
        await rig.guided.sample(quiet)
    assert refused.value.cause == "measurement.hand_eye.not_settled"
    assert "limit 1 mrad" in str(refused.value)
    assert len(rig.guided.session.samples) == 1


@pytest.mark.parametrize(
    ("boards", "cause", "what"),
    [
        ([], "measurement.hand_eye.marker_not_seen", "marker 582 seen in 0 of 1 pictures, 1 are wanted"),
        ([{"kind": "marker", "marker_id": 583, "position_m": [0.0, 0.0, 0.001]}],
         "measurement.hand_eye.wrong_marker", "583"),
    ],
)  # fmt: skip
async def test_no_marker_or_another_one_is_said(
    tmp_path: Path, boards: list[dict[str, Any]], cause: str, what: str
) -> None:
    settings = still_settings(**QUICK)
    settings = settings._replace(
        scene=type(settings.scene).model_validate(settings.scene.model_dump() | {"boards": boards})
    )
    rig = StillRig(settings, tmp_path)
    with pytest.raises(MeasurementFailed, match=what) as refused:
        await rig.guided.start("monday", rig.guided.defaults, 1, quiet)
    assert refused.value.cause == cause
    assert rig.guided.store.names() == []


async def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    with pytest.raises(RequestRefused, match="no session is open"):
        _ = rig.guided.session
    with pytest.raises(RequestRefused, match="letters, digits"):
        await rig.guided.start("../escape", rig.guided.defaults, 1, quiet)
    await rig.guided.start("monday", rig.guided.defaults, 1, quiet)
    with pytest.raises(RequestRefused, match="take a sample at the starting pose first"):
        await rig.guided.next_pose(quiet)
    with pytest.raises(RequestRefused, match="is on the disk"):
        await rig.guided.start("monday", rig.guided.defaults, 1, quiet)
    with pytest.raises(RequestRefused, match="no sample '7'; there are: none"):
        rig.guided.remove("7")
    with pytest.raises(RequestRefused, match="no session 'sunday'; there are: monday"):
        rig.guided.resume("sunday")
    tool = rig.guided.defaults.model_copy(update={"marker_id": 0})
    with pytest.raises(RequestRefused, match="marker 0 is the tool's"):
        await rig.guided.start("tuesday", tool, 1, quiet)
    await rig.guided.sample(quiet)
    with pytest.raises(RequestRefused, match="the same sample twice") as refused:
        rig.guided.session.with_sample(rig.guided.session.samples[0]._replace(name="2"))
    assert refused.value.cause == "refused.hand_eye.duplicate"


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda d: d.update(format="longreach-hand-eye-session/9"), "format is"),
        (lambda d: d["samples"][0].pop("hand"), "key 'hand'"),
        (lambda d: d["samples"][0].update(camera=[[1.0, 0.0], [0.0, 1.0]]), "shape"),
        (lambda d: d["samples"][0].update(marker_id=17), "sample 1: marker 17, but 582"),
        (lambda d: d["samples"][0]["hand"][0].__setitem__(3, 3894.0), "sample 1.*in millimetres"),
        (lambda d: d["samples"][0]["hand"].reverse(), "sample 1"),
        (lambda d: d["settings"].update(poses=2), "poses"),
        (lambda d: d["samples"].append(dict(d["samples"][0])), "a name given twice"),
    ],
)
async def test_a_spoiled_session_file_is_refused_by_name(tmp_path: Path, change: Any, what: str) -> None:
    rig = quick_rig(tmp_path)
    await begun(rig)
    file = tmp_path / "monday.json"
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))
    with pytest.raises(RequestRefused, match=what) as refused:
        rig.guided.resume("monday")
    assert refused.value.cause.startswith("refused.hand_eye.")
    assert rig.guided.session.samples[0].name == "1"  # what was open stays open


async def test_an_interrupted_write_leaves_the_session_before(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    await begun(rig)
    (tmp_path / "monday.part").write_text('{"format": "longreach-hand-e')
    assert len(rig.guided.resume("monday").samples) == 1


class _Camera:
    """A camera whose pictures come."""

    carries = False  # no targets

    def status(self) -> CameraStatus:
        return CameraStatus(True, 0.0, 1, 10.0)


async def test_the_session_over_rest(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path)
    operations = Operations(rig.halt, rig.log)
    standing = SimpleNamespace(group_state=GroupState.STANDBY, flags=0, fault=FaultCode.NONE)
    controller: Any = SimpleNamespace(state=standing, connected=True)
    programs = rig.settings.vision.programs
    eyes: Any = rig
    application = VisionApplication(  # type: ignore[arg-type]
        rig, eyes, controller, _Camera(), programs, BOOM, rig.log, rig.guided
    )
    app = create_app(application, operations)
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://vision") as client:

        async def done(kind: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
            answer = await client.post(f"/operations/hand-eye-{kind}", json=body)
            assert answer.status_code == 202, answer.text
            operation = operations.get(answer.json()["id"])
            await operation.wait()
            return (await client.get(f"/operations/{operation.id}")).json()

        assert (await client.get("/hand-eye/session")).json()["cause"] == "refused.hand_eye.no_session"
        started = await done("start", {"name": "rest", "poses": 5})
        assert started["result"]["verdict"] == "marker 582 seen, 0/5: ready"
        assert (await done("sample"))["result"]["sample"] == "1"
        keyed = [
            await client.post("/operations/hand-eye-solve", headers={"Idempotency-Key": "k"})
            for _ in range(2)
        ]
        assert keyed[0].headers["Location"] == keyed[1].headers["Location"]
        await operations.close()
        assert (await done("next"))["result"]["choices"] > 5
        rig.drift_mrad, rig.settled = 5.0, False
        failed = await done("sample")
        assert (failed["state"], failed["problem"]["cause"]) == ("failed", "measurement.hand_eye.not_settled")
        rig.drift_mrad, rig.settled = 0.0, True
        assert (await done("sample"))["result"]["count"] == 2
        assert (await done("next"))["state"] == "succeeded"
        assert (await done("sample"))["state"] == "succeeded"
        assert (await client.delete("/hand-eye/session/samples/2")).json()["count"] == "2/5"
        too_few = await done("solve")
        assert too_few["problem"]["cause"] == "measurement.hand_eye.too_few_samples"
        assert (await client.get("/hand-eye/sessions")).json() == {"names": ["rest"]}
        view = (await client.post("/hand-eye/session/resume", json={"name": "rest"})).json()
        assert [s["name"] for s in view["samples"]] == ["1", "3"]
        bad = await client.post("/operations/hand-eye-start", json={"name": "x", "poses": 2})
        assert bad.status_code == 422
