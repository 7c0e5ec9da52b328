"""When poses of a map are believed where something large moved before the camera."""

from vision_pc.core.odometry.map_trust import MapTrust

PROBATION = 20


def after(located: int, doubted: bool = False) -> MapTrust:
    trust = MapTrust(doubted)
    for _ in range(located):
        trust.located()
    return trust


def test_two_motions_that_nothing_tells_apart_make_a_young_map_ambiguous() -> None:
    for located, doubted, ambiguous in ((19, False, True), (20, False, False), (20, True, True)):
        trust = after(located, doubted)
        assert not trust.ambiguous
        trust.unresolved()
        assert trust.ambiguous is ambiguous
        assert trust.believes(7) is not ambiguous


def test_after_an_ambiguous_map_poses_are_believed_once_twenty_pairs_were_located() -> None:
    assert [after(count, doubted=True).believes(7) for count in (0, 19, 20)] == [False, False, True]


def test_poses_of_one_motion_are_withdrawn_when_two_are_found_in_the_same_keyframes() -> None:
    """The first pose is right, and what was found while both were known stands."""
    trust = MapTrust(doubted=False)
    for capture_ns, number in ((0, 1), (1, 1), (2, 3), (3, 4)):
        trust.checked(capture_ns, number, None, located=True)
        trust.located()
    trust.checked(4, 5, None, located=False)  # lost: nothing to withdraw
    trust.checked(5, 5, 2, located=True)
    assert [trust.believes(k) for k in range(6)] == [True, True, False, False, True, True]
    trust.checked(6, 5, 0, located=True)
    assert [trust.believes(k) for k in range(6)] == [True, False, False, False, True, True]
