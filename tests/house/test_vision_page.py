"""docs/vision.md against the code: files and coroutines that it names exist, its numbers are configured."""

import importlib
import re
from pathlib import Path

from foundation.configuration import load
from vision_pc.config.vision import VisionConfig

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "vision.md").read_text(encoding="utf-8")
FLAT = " ".join(PAGE.split())


def test_every_file_that_the_page_names_exists() -> None:
    names = {path.name for path in (ROOT / "vision_pc").rglob("*.py")}
    named = set(re.findall(r"`(?:[a-z_]+/)*([a-z_0-9]+\.py)", PAGE))
    assert len(named) > 20
    assert not named - names


def test_the_calibration_programs_are_coroutines_of_their_files() -> None:
    rows = re.findall(r"`([a-z_]+)\.py: ([a-z_]+)` \|", PAGE)
    assert len(rows) == 4
    for module, coroutine in rows:
        assert hasattr(importlib.import_module(f"vision_pc.core.calibration.{module}"), coroutine)


def test_the_numbers_of_the_page_are_the_configuration_s() -> None:
    config = load(VisionConfig, ROOT / "configs" / "vision.yaml")
    servoing, positioning = config.programs.looking_and_moving, config.programs.positioning
    for text in (
        f"A look takes {config.look.frames} frames",
        f"fewer than {config.look.minimum_frames} frames",
        f"never believed better than {config.markers.offset_floor_px:g} px",
        f"fewer than {config.odometry.keyframe_overlap:g} of a keyframe's points",
        f"the {config.odometry.adjusted_keyframes} newest keyframes",
        f"the clearance b = {positioning.clearance_m:.2f} m",
        f"drives {config.programs.local_map.first_share:g} of the way",
        f"residual is above {1e3 * positioning.nudge_m:g} mm",
        f"at most {servoing.lead_m:.2f} m ahead",
        f"older than {servoing.hold_s:g} s the arm is held; after {servoing.lost_s:g} s without",
    ):
        assert text in FLAT, text
