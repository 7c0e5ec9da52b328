"""A patch that was taught is found again by its looks, or it is said why not."""

import cv2
import numpy as np
import pytest

from tests.vision_pc.rendering import facing
from tests.vision_pc.targets.wall_scene import SIZE, WallScene, rock, scene
from vision_pc.core import se3
from vision_pc.core.targets.known_target import again, anywhere
from vision_pc.core.targets.measuring import at_click
from vision_pc.core.targets.sighting import Click, KnownTarget
from vision_pc.core.targets.target import TargetObservation, TargetRefused, frame_on

PLACE = (-0.05, 0.12)
BEFORE, AFTER = facing(0.03, -0.02, 1.0, (9.0, -13.0, 4.0)), facing(-0.04, 0.05, 1.12, (-3.0, 7.0, -9.0))


@pytest.fixture(scope="module")
def wall() -> WallScene:
    return scene(rock(), BEFORE)


@pytest.fixture(scope="module")
def later() -> WallScene:
    return scene(rock(), AFTER, seed=9)


@pytest.fixture(scope="module")
def taught(wall: WallScene) -> TargetObservation:
    return at_click(wall.sighted(), Click("left", wall.pixel(*PLACE), "template"))


def known(of: TargetObservation, X: se3.Array | None = None) -> KnownTarget:
    return KnownTarget("template", of.X_CO if X is None else X, of.covariance, None, of.taught)


def across_mm(X: se3.Array, true: se3.Array) -> float:
    ray = true / np.linalg.norm(true)
    off = X[:3, 3] - true
    return 1e3 * float(np.linalg.norm(off - ray * (ray @ off)))


def test_it_is_found_from_elsewhere_to_a_fifth_of_a_millimetre_and_turned_as_it_is(
    wall: WallScene, later: WallScene, taught: TargetObservation
) -> None:
    assert taught.kind == "template"
    seen = anywhere(later.sighted(), known(taught))
    true = later.point(*PLACE)
    assert across_mm(seen.X_CO, true) < 0.2
    # The true frame goes with the wall, its turn about the normal too.
    X = AFTER @ se3.inverse(BEFORE) @ frame_on(wall.point(*PLACE), BEFORE[:3, 2])
    off = se3.local(seen.X_CO, X)
    assert np.degrees(np.linalg.norm(off[3:])) < 1.5
    assert off @ np.linalg.solve(seen.covariance, off) < 30.0  # χ² of six: 1 in 25,000
    assert np.sqrt(np.diag(seen.covariance))[:2].max() < 0.004


def test_a_programs_look_measures_it_where_it_is_expected(
    later: WallScene, taught: TargetObservation
) -> None:
    X = AFTER @ se3.inverse(BEFORE) @ taught.X_CO
    off = X @ se3.transform(se3.exp_so3([0.01, -0.01, 0.02]), [0.008, -0.006, 0.005])
    seen = again(later.sighted(), known(taught, off))
    assert across_mm(seen.X_CO, later.point(*PLACE)) < 0.2
    far = X @ se3.transform(np.eye(3), [0.2, -0.15, 0.0])
    with pytest.raises(TargetRefused) as caught:
        again(later.sighted(), known(taught, far))
    assert caught.value.cause == "target.not_found"


def test_it_is_not_found_on_another_wall(taught: TargetObservation) -> None:
    with pytest.raises(TargetRefused) as caught:
        anywhere(scene(rock(seed=77), AFTER).sighted(), known(taught))
    assert caught.value.cause in ("target.not_found", "target.ambiguous")


@pytest.mark.slow("three walls are drawn and searched")
def test_what_looks_like_another_place_is_not_taught_and_not_found() -> None:
    cells = np.tile(rock(seed=5)[:250, :250], (8, 8))[:SIZE, :SIZE]  # the same every 0.25 m
    tiled = scene(cells, BEFORE)
    pixel = tiled.pixel(-0.1, 0.1)
    with pytest.raises(TargetRefused) as caught:
        at_click(tiled.sighted(), Click("left", pixel, "template", other=tiled.pixel(-0.1, 0.1, "right")))
    assert caught.value.cause == "target.ambiguous"
    once = rock(seed=6)
    once[800:1050, 800:1050] = cells[:250, :250]
    single = scene(once, BEFORE)
    made = at_click(single.sighted(), Click("left", single.pixel(-0.075, 0.075), "template"))
    with pytest.raises(TargetRefused) as caught:
        anywhere(tiled.sighted(), known(made))
    assert caught.value.cause == "target.ambiguous"


@pytest.mark.parametrize(("alike_texels", "ambiguous"), [(4.0, False), (2.0, True)])
def test_a_place_that_looks_alike_from_afar_alone_is_told_from_it_by_its_fine_texture(
    taught: TargetObservation, alike_texels: float, ambiguous: bool
) -> None:
    wall, other = rock(), rock(seed=8)
    fine = other - cv2.GaussianBlur(other, (0, 0), alike_texels)
    here, there = np.s_[805:955, 875:1025], np.s_[1075:1225, 1055:1205]  # the first about PLACE
    wall[there] = cv2.GaussianBlur(wall, (0, 0), alike_texels)[here] + fine[here]
    both = scene(wall, AFTER, seed=9)
    if ambiguous:
        with pytest.raises(TargetRefused) as caught:
            anywhere(both.sighted(), known(taught))
        assert caught.value.cause == "target.ambiguous"
    else:
        assert across_mm(anywhere(both.sighted(), known(taught)).X_CO, both.point(*PLACE)) < 0.2


def test_a_patch_on_the_edge_of_a_shade_is_told_from_other_places_on_that_edge() -> None:
    wall = rock(contrast=12.0)
    rows, columns = np.indices(wall.shape)
    wall[columns - 875.0 > 1.4 * (rows - 880.0)] *= 0.4  # goes through PLACE
    made = at_click(
        (before := scene(wall, BEFORE)).sighted(), Click("left", before.pixel(*PLACE), "template")
    )
    later = scene(wall, AFTER, seed=9)
    assert across_mm(anywhere(later.sighted(), known(made)).X_CO, later.point(*PLACE)) < 0.3


def test_only_a_template_is_found_anywhere(wall: WallScene, taught: TargetObservation) -> None:
    with pytest.raises(TargetRefused) as caught:
        anywhere(wall.sighted(), KnownTarget("plane", taught.X_CO, taught.covariance, None))
    assert caught.value.cause == "target.not_taught"
