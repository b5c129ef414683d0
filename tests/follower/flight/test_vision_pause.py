"""Vision gives way to control on a board that is too small for both."""

import math

from follower.flight.threads import VisionPause

LATE_S = 0.01


def pauses(lateness_s: list[float]) -> list[float]:
    """How long vision rests after each frame, when the control step before it was so late."""
    pause, found = VisionPause(LATE_S), []
    for late_s in lateness_s:
        pause.note(late_s)
        pause.note(0.0)
        found.append(pause.after_frame())
    return found


def test_vision_does_not_rest_while_control_is_on_time():
    assert pauses([0.0, 0.001, LATE_S] * 20) == [0.0] * 60


def test_it_rests_longer_while_control_stays_late_but_never_so_long_that_frames_are_stale():
    rests = pauses([0.03] * 20)
    assert rests[0] > 0.0
    assert rests == sorted(rests)
    assert rests[-1] < 0.5


def test_it_sees_as_often_as_before_once_control_is_on_time_again():
    rests = pauses([math.inf] * 20 + [0.0] * 200)[20:]
    assert rests == sorted(rests, reverse=True)
    assert rests[-1] == 0.0
