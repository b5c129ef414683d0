"""The page that has to be there while following."""

from follower.flight.supervision.pilot_and_operator import CockpitWatch
from follower.settings.ui import CockpitSettings

HOLD = CockpitSettings(when_lost="hold", lost_s=2.0)


def test_by_default_nobody_is_missed() -> None:
    watch = CockpitWatch(CockpitSettings())
    assert not any(watch.is_lost(t) for t in (0.0, 5.0, 1e6))


def test_a_page_that_never_came_is_missed_where_one_has_to_be_there() -> None:
    assert CockpitWatch(HOLD).is_lost(0.0)


def test_it_is_missed_after_its_time_and_no_longer_when_it_is_back() -> None:
    watch = CockpitWatch(HOLD)
    watch.note()
    assert not watch.is_lost(10.0)
    assert not watch.is_lost(12.0)
    assert watch.is_lost(12.01)
    watch.note()
    assert not watch.is_lost(13.0)


def test_it_counts_from_the_step_that_hears_it() -> None:
    """No thread of a server's asks for the time: the control step's is what is recorded."""
    watch = CockpitWatch(HOLD)
    watch.note()
    watch.note()
    assert not watch.is_lost(100.0)
    assert watch.is_lost(102.5)
