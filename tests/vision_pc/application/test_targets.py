"""Targets kept over a session: carried by odometry, lost by what nobody watched, forgotten."""

import numpy as np
import pytest

from protocol.errors import RequestRefused
from tests.vision_pc.program_settings import shipped
from vision_pc.application.targets.view import target_json
from vision_pc.config.programs import TargetSettings
from vision_pc.core import se3
from vision_pc.core.targets.keeper import TargetKeeper
from vision_pc.core.targets.target import TargetObservation

START, AFTER = se3.transform(np.eye(3), [3.9, 0.0, 1.0]), se3.transform(np.eye(3), [4.2, 0.1, 1.1])
X_CO = se3.transform(np.diag([1.0, -1.0, -1.0]), [0.1, -0.05, 1.0])
SEEN = TargetObservation("hole", X_CO, 1e-8 * np.eye(6), 1e-9 * np.eye(6), 0.9, np.zeros((4, 2)), 0.045)


def keeper(count: int = 1) -> TargetKeeper:
    kept = TargetKeeper(TargetSettings())
    for _ in range(count):
        kept.add(SEEN, 7, START, None)
    return kept


def test_odometry_carries_every_target_and_its_doubt_grows() -> None:
    kept = keeper(2)
    X_C0C = se3.transform(se3.exp_so3([0.01, 0.02, -0.01]), [0.1, 0.02, 0.3])
    kept.carry(X_C0C, START, AFTER)
    for target in kept.list():
        assert target.known == "carried"
        assert np.allclose(X_C0C @ target.X_CO, X_CO)
        assert np.all(np.diag(target.covariance)[:3] > 2.0 * 1e-8)
        assert target.way_m == pytest.approx(np.linalg.norm(X_C0C[:3, 3]))
    kept.refuse_lost(AFTER)
    kept.looked(X_CO, SEEN.covariance, AFTER, measured=True)
    assert kept.get("t2").known == "measured"
    assert kept.get("t1").known == "carried"


def test_a_motion_that_nobody_watched_loses_it() -> None:
    kept = keeper()
    with pytest.raises(RequestRefused, match="click it again") as caught:
        kept.refuse_lost(AFTER)
    assert caught.value.cause == "refused.target_lost"
    one, settings = kept.get("t1"), shipped().positioning
    told = [target_json(one, kept, settings, None, at)["known"] for at in (None, START, AFTER)]
    assert told == ["measured", "measured", "lost"]
    kept.carry(None, START, AFTER)
    assert kept.get("t1").known == "lost"
    kept.carry(np.eye(4), AFTER, AFTER)  # what is lost is not found by standing still
    assert kept.get("t1").known == "lost"


def test_a_motion_that_was_refused_loses_nothing() -> None:
    kept = keeper()
    crept = se3.transform(np.eye(3), START[:3, 3] + [0.001, 0.0, 0.0])
    kept.carry(None, START, crept)
    one = kept.get("t1")
    assert (one.known, one.way_m) == ("measured", 0.0)
    kept.refuse_lost(crept)
    kept.carry(None, AFTER, AFTER)  # it was clicked elsewhere
    assert one.known == "lost"


def test_the_newest_is_aimed_at_and_forgetting_it_goes_back_to_the_markers() -> None:
    kept = keeper(3)
    aimed = kept.aimed
    assert aimed is not None
    assert aimed.id == "t3"
    kept.aim("t1")
    kept.remove("t1")
    assert kept.aimed is None
    with pytest.raises(RequestRefused) as caught:
        kept.aim("t1")
    assert caught.value.cause == "refused.unknown_target"
    assert keeper(150).list()[0].id == "t51"


def test_how_well_a_place_is_known_is_told_by_the_line_of_sight() -> None:
    kept = keeper()
    target = kept.get("t1")
    ray = X_CO[:3, 3] / np.linalg.norm(X_CO[:3, 3])
    target.covariance[:3, :3] = 1e-8 * np.eye(3) + (0.004**2 - 1e-8) * np.outer(ray, ray)
    told = target_json(target, kept, shipped().positioning, None, None)
    assert told["std_sight_mm"] == {"across": 0.1, "along": 4.0}
    assert told["std_mm"]["x"] > 0.3  # the axes mix both where the target is beside the middle
