"""Marker limits: corners of rendered markers are where they are said to be; readers are judged by them."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Finished
from laboratory.experiments.markers import one_picture as one_picture_module
from laboratory.experiments.markers.limits import LimitSettings, limit_tasks, limit_verdict
from laboratory.experiments.markers.one_picture import (
    AXES,
    EMPTY,
    TIME,
    LimitRow,
    MarkerReading,
    MarkersSeen,
    judged,
    one_picture,
    readers,
)
from laboratory.experiments.markers.rendered_tags import MarkerAspect, TagPicture, clutter, tags
from protocol.errors import ConfigurationError

CONFIGS = Path("configs")
FAMILY = "DICT_APRILTAG_36h11"
SQUARE = 40.0 * np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]])


def request(runs: int = 2) -> CampaignRequest:
    return CampaignRequest(CONFIGS, Path("nowhere"), runs=runs, seed=5)


def test_light_across_an_upright_edge_tells_where_the_corners_are() -> None:
    """The centroid of the light's change along a row is the edge, whatever the blur."""
    picture = tags(FAMILY, MarkerAspect(60.0, 0.0, 1.0, 0.0), np.random.default_rng(3), 1)
    (corners,) = picture.corners.values()
    middle = corners.mean(axis=0)
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        along = (b - a) / np.linalg.norm(b - a)
        out = np.array([along[1], -along[0]]) * np.sign(np.dot((along[1], -along[0]), a - middle))
        steps = np.arange(-3.4, 3.4, 0.05)
        offsets = []
        for share in np.linspace(0.2, 0.8, 30):
            at = (a + share * (b - a) + steps[:, None] * out).astype(np.float32)
            light = cv2.remap(
                picture.image.astype(np.float32), at[None, :, 0], at[None, :, 1], cv2.INTER_LINEAR
            )
            change = np.diff(light.ravel())
            offsets.append((change * (steps[1:] - 0.025)).sum() / change.sum())
        assert abs(float(np.mean(offsets))) < 0.03


@pytest.mark.parametrize("name", ["ours", "none", "subpix", "contour", "apriltag"])
def test_every_reader_reads_plain_markers_with_their_corners_in_order(name: str) -> None:
    picture = tags(FAMILY, MarkerAspect(60.0), np.random.default_rng(1))
    seen = judged(readers(FAMILY)[name](picture.image), [], picture)
    assert (seen.found, seen.false) == (18, 0)
    assert math.sqrt(seen.square / 18 / 8) < {"ours": 0.04, "apriltag": 0.2}.get(name, 0.8)


def test_a_wrong_number_a_wrong_place_and_turned_corners_are_false() -> None:
    picture = TagPicture(np.zeros((2, 2), np.uint8), {7: SQUARE})
    for wrong in (
        MarkerReading(8, SQUARE),
        MarkerReading(7, SQUARE + 6.0),
        MarkerReading(7, np.roll(SQUARE, 1, axis=0)),
    ):
        seen = judged([wrong], [], picture)
        assert (seen.found, seen.false) == (0, 1)
    seen = judged([MarkerReading(7, SQUARE + 1.0)], [MarkerReading(7, SQUARE + 2.0)], picture)
    assert (seen.found, seen.square, seen.shared, seen.shared_square, seen.ours_square) == (
        1,
        8.0,
        1,
        8.0,
        32.0,
    )


def test_clutter_is_without_markers_and_not_plain() -> None:
    image = clutter(MarkerAspect(), np.random.default_rng(2))
    _, ids, rejected = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    ).detectMarkers(image)
    assert ids is None
    assert len(rejected) >= 5


@pytest.mark.slow("a row of every kind is measured")
def test_rows_of_every_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(one_picture_module, "_ROUNDS", 1)
    usual = {"family": FAMILY, "seed": 1}
    row = one_picture(CONFIGS, usual | {"axis": "side", "value": 30})
    assert row.markers == row.ours.found == row.subpix.found == 18
    assert row.subpix.ours_square < row.subpix.shared_square
    assert 0.0 < row.nees < 8 * 18 * 20
    empty = one_picture(CONFIGS, usual | {"axis": EMPTY, "value": 2})
    assert (empty.markers, empty.ours.found, empty.ours.false) == (0, 0, 0)
    timed = one_picture(CONFIGS, usual | {"axis": TIME, "value": 0})
    assert timed.markers == 4
    assert min(timed.known_ms, timed.tracked_ms, timed.ours.ms, timed.none.ms) > 0.0


def test_unknown_axes_and_families_are_refused() -> None:
    assert len(limit_tasks(request(), LimitSettings())) == 2 * (sum(map(len, AXES.values())) + 5)
    with pytest.raises(ConfigurationError, match="--axis sides: one of side, "):
        limit_tasks(request(), LimitSettings(axis=["sides"]))
    with pytest.raises(ConfigurationError, match="--family DICT_5X5_1000: one of "):
        limit_tasks(request(), LimitSettings(family="DICT_5X5_1000"))


def test_the_verdict_names_what_falls_short() -> None:
    ours = MarkersSeen(18, 0, 1.0, 18, 1.0, 1.0, 9.0)
    peer = MarkersSeen(17, 0, 9.0, 18, 2.0, 1.0, 9.0)
    good = LimitRow("side", 20.0, 5, 18, ours, peer, peer, peer, peer, nees=144.0)
    empty = good._replace(
        axis=EMPTY, markers=0, **dict.fromkeys(("ours", "none"), MarkersSeen(0, 0, 0.0, 0, 0.0, 0.0))
    )
    timed = good._replace(axis=TIME, known_ms=8.0, tracked_ms=3.0)
    assert all(check.met is not False for check in _checks([good, empty, timed]))
    for worse, words in (
        (good._replace(none=peer._replace(found=18.5)), "found over side, px, beside none"),
        (
            good._replace(contour=peer._replace(ours_square=3.0)),
            "corner rms over that of contour, worst at side, px 20",
        ),
        (good._replace(ours=ours._replace(false=1)), "false markers in 1 pictures with markers"),
        (good._replace(failure="x"), "runs that failed"),
    ):
        assert [check.what for check in _checks([worse, empty, timed]) if check.met is False] == [words]
    slow = [check.what for check in _checks([good, timed._replace(tracked_ms=7.0)]) if check.met is False]
    assert slow == ["CPU of a tracked 720p picture"]


def _checks(rows: list[LimitRow]) -> list[Check]:
    return list(limit_verdict(Finished(request(1), LimitSettings(), (), rows, 0)))
