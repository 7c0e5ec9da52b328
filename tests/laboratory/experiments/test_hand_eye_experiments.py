"""The experiments small, the command as a user calls it; the full experiments run with ``-m experiment``."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished, NoSettings
from laboratory.experiments.hand_eye import localisation, scenes
from laboratory.experiments.hand_eye.hua import localisation_tables, localisation_verdict
from laboratory.experiments.hand_eye.noise_sweep import noise_level
from laboratory.experiments.hand_eye.stress import BAD_SAMPLES, SMALL_ROTATIONS, attempted, rows_of
from tests.support.board_pictures import BoardCamera, BoardRenderer, random_board_pose
from tests.support.commands import ran
from tests.support.paths import CONFIGS
from vision_pc.config.choices import Method
from vision_pc.core.perception.zhang_intrinsics import Checkerboard

pytestmark = pytest.mark.slow("whole experiments, small")


def test_printed_pose_and_table_of_the_paper_are_proper() -> None:
    scene = scenes.table_1_scene()
    norms = np.linalg.norm(scenes.TABLE_1[:, :4], axis=1)
    assert norms.min() == pytest.approx(0.48, abs=0.01)
    assert norms.max() == pytest.approx(0.84, abs=0.01)
    R = scenes.PRINTED_X[:3, :3]
    assert np.linalg.det(R) == pytest.approx(1.0, abs=2e-3)
    assert np.abs(scene.X[:3, :3] - R).max() < 2e-3


def test_small_sweep_reaches_the_bound_and_repeats() -> None:
    chosen = [Method.HORAUD, Method.DQCR, Method.ROBUST]
    sweep = noise_level(6, 10, 1, chosen)
    rows = {r.method: r for r in sweep}
    assert rows["dqcr"].rotation_deg == pytest.approx(rows["horaud"].rotation_deg, rel=0.1)
    assert rows["robust"].rotation_deg < 0.4 * rows["dqcr"].rotation_deg
    assert rows["robust"].rotation_over_bound < 1.6
    assert noise_level(6, 10, 1, chosen) == sweep


def test_small_localisation_favours_the_robust_solver() -> None:
    asked = {"seed": 1, "repetitions": 10}
    rows = [localisation.calibration_row(CONFIGS, asked | {"run": run}) | {"failure": None} for run in (0, 1)]
    errors = localisation.errors_of(row["entries"] for row in rows)
    assert errors["robust", "all 17"].shape == (2, 3, 10)
    mean = {key: float(mm.mean()) for key, mm in errors.items()}
    assert mean["robust", "all 17"] < mean["dqcr", "12 kept by hand"]
    assert mean["dqcr", "all 17"] > 5.0
    done = Finished(CampaignRequest(CONFIGS, CONFIGS), NoSettings(), (), rows, 0)
    assert localisation_verdict(done)[0].met
    cells = [list(column.cells) for column in localisation_tables(done)[0].columns]
    assert cells[0][0] == "tsai"
    assert [column[0] for column in cells[3:]][::2] == ["4.4", "79 %"]


def test_a_method_that_refuses_is_counted_and_is_no_number() -> None:
    entry = ["robust", "all 17", [[None, None]] * 3]
    rows = [{"entries": [entry, ["dqcr", "12 kept by hand", [[1.0, 3.0]] * 3]], "failure": None}]
    rows += [{"entries": [["robust", "all 17", [[1.0, 5.0]] * 3]], "failure": None}]
    done = Finished(CampaignRequest(CONFIGS, CONFIGS), NoSettings(), (), rows, 0)
    assert localisation_verdict(done)[0].met is False
    (shown,) = localisation_tables(done)
    assert [next(iter(column.cells)) for column in shown.columns][2::2] == ["3.00", "50%", "1"]


def test_small_stress_has_no_improper_answer() -> None:
    bad = rows_of(BAD_SAMPLES, attempted(BAD_SAMPLES, range(4), 1))
    assert not any(r.improper for r in bad)
    robust = next(r for r in bad if r.method == "robust")
    assert robust.found == 1.0
    assert robust.rotation_median_deg < 0.3
    few = attempted(SMALL_ROTATIONS, range(4), 1, [Method.ROBUST, Method.DQCR])
    assert rows_of(SMALL_ROTATIONS, few)[0].refused == 0


def test_intrinsics_of_pictures(tmp_path: Path) -> None:
    camera = BoardCamera(
        np.array([[300.0, 0.0, 150.0], [0.0, 300.0, 115.0], [0.0, 0.0, 1.0]]),
        np.zeros(5),
        300,
        230,
        noise_grey=1.0,
    )
    renderer, board, rng = BoardRenderer(camera), Checkerboard(5, 4, 0.03), np.random.default_rng(3)
    files = []
    for k in range(5):
        files.append(tmp_path / f"b{k}.png")
        cv2.imwrite(str(files[-1]), renderer.render(board, random_board_pose(camera, board, rng), rng))
    report = tmp_path / "k.json"
    options = ["--columns", "5", "--rows", "4", "--square-mm", "30", "--json", str(report)]
    ran("hand-eye", "intrinsics", *files, *options)
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["K"][0][0] == pytest.approx(300.0, rel=0.02)
    assert set(figures["view_rms_px"]) == {f"b{k}" for k in range(5)}
