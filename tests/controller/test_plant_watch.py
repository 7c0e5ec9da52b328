"""The plant watched through its images: each limit from both sides, counters over their wrap."""

import pytest

from controller.core.plant_watch import (
    PlantRefusal,
    PlantWatch,
    cycle_frozen,
    link_lost,
    unseen,
    update_watch,
)
from controller.core.settings import ScanSettings
from protocol.process_image import SensorImage

IMAGE = SensorImage(100, 50, 1, (0,) * 6, ((60.0, 60.0),) * 6, 190.0, 10.0, 40.0)
DT_S = 0.001  # short, so that exchanges are counted before silence is


def seen(cycle: int = 50) -> PlantWatch:
    """After one good exchange."""
    return update_watch(unseen(), IMAGE._replace(echo_cycle=cycle % 65536), cycle, DT_S)


def test_as_many_failed_exchanges_in_a_row_as_the_limit_are_survived_and_one_more_is_not(
    settings: ScanSettings,
) -> None:
    limit = settings.supervision.missed_exchanges
    watch = seen()
    for missed in range(1, limit + 2):
        watch = update_watch(watch, None, 50, DT_S)
        assert link_lost(settings, watch) == (None if missed <= limit else (missed, limit))
    assert link_lost(settings, update_watch(watch, IMAGE._replace(plant_cycle=101), 50, DT_S)) is None


def test_silence_is_lost_beyond_its_time_and_not_at_it(settings: ScanSettings) -> None:
    limit_s = settings.supervision.silence
    assert link_lost(settings, update_watch(seen(), None, 50, limit_s)) is None
    late = update_watch(seen(), None, 50, limit_s + 1e-6)
    assert link_lost(settings, late) == pytest.approx((limit_s + 1e-6, limit_s))


def test_a_plant_cycle_that_stands_is_frozen_beyond_its_limit(settings: ScanSettings) -> None:
    limit = settings.supervision.frozen_exchanges
    watch = seen()
    for frozen in range(1, limit + 2):
        watch = update_watch(watch, IMAGE, 50, DT_S)
        assert cycle_frozen(settings, watch) == (None if frozen <= limit else (frozen, limit))
    assert cycle_frozen(settings, update_watch(watch, IMAGE._replace(plant_cycle=101), 50, DT_S)) is None


def test_failed_exchanges_neither_count_as_a_standing_cycle_nor_begin_it_anew(settings: ScanSettings) -> None:
    watch = update_watch(seen(), IMAGE, 50, DT_S)
    watch = update_watch(watch, None, 50, DT_S)
    assert watch.frozen == 1
    assert update_watch(watch, IMAGE, 50, DT_S).frozen == 2


@pytest.mark.parametrize("cycle", [50, 65535, 3, 0])
def test_an_echo_is_lost_when_it_lags_more_than_its_limit_over_the_wrap_too(
    settings: ScanSettings, cycle: int
) -> None:
    limit = settings.supervision.echo_lag_cycles
    for lag in (0, 1, limit):
        image = IMAGE._replace(plant_cycle=101, echo_cycle=(cycle - lag) % 65536)
        assert link_lost(settings, update_watch(seen(), image, cycle, DT_S)) is None
    image = IMAGE._replace(plant_cycle=101, echo_cycle=(cycle - limit - 1) % 65536)
    assert link_lost(settings, update_watch(seen(), image, cycle, DT_S)) == (limit + 1, limit)


def test_an_echo_of_a_cycle_that_was_never_sent_is_a_lost_link(settings: ScanSettings) -> None:
    image = IMAGE._replace(plant_cycle=101, echo_cycle=51)
    assert link_lost(settings, update_watch(seen(), image, 50, DT_S)) is not None


@pytest.mark.parametrize("code", [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 255])
def test_a_refusal_is_lost_at_once_unless_it_says_busy(settings: ScanSettings, code: int) -> None:
    watch = update_watch(seen(), PlantRefusal(code), 50, DT_S)
    lost = link_lost(settings, watch)
    assert (lost is None) == (code == 6)
    assert link_lost(settings, update_watch(watch, IMAGE._replace(plant_cycle=101), 50, DT_S)) is None
