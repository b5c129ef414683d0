"""The setpoints of a recording: a step every 20 ms of it, bounded whatever its times are."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from follower.flight.control.offline import RecordedControl
from follower.flight.log import FlightLog, TrackRecord
from follower.settings.settings import Settings, load_settings
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import Track, TrackState

DAY_S = 86_400.0
WIDTH, HEIGHT = 160, 120


def steps(times_s: list[float], settings: Settings | None = None) -> FlightLog:
    """Control through frames of these times; all show the target in the middle."""
    log = FlightLog()
    first = Frame(np.zeros((HEIGHT, WIDTH, 3), np.uint8), times_s[0], 0)
    control = RecordedControl(settings or load_settings(), log, first)
    for number, (now_s, next_s) in enumerate(pairwise([*times_s, None])):
        assert now_s is not None
        box = Box(WIDTH / 2, HEIGHT / 2, 20, 20)
        track = Track(box, TrackState.TRACKING, 1.0, "test", now_s, number)
        control.step(TrackRecord(track, number, now_s, now_s, now_s, 0.0), next_s)
    return log


def test_there_is_a_setpoint_every_20_ms() -> None:
    log = steps([5.0 + 0.11 * number for number in range(10)])
    times = [record.time_s for record in log.controls]
    assert times == pytest.approx([5.0 + 0.02 * number for number in range(51)])
    assert not [event for event in log.events if event.source == "video"]


def test_a_jump_of_the_time_stamps_is_told_and_not_stepped_through() -> None:
    log = steps([0.0, 0.1, DAY_S, DAY_S + 0.1])
    times = np.array([record.time_s for record in log.controls])
    assert len(times) == pytest.approx(5 + 500 + 5, abs=3)
    assert times[(times > 10.2) & (times < DAY_S)].size == 0
    assert all(np.isfinite(record.allowed.values).all() for record in log.controls)
    (told,) = [event.text for event in log.events if event.source == "video"]
    assert "no frame for 86400 s" in told


def test_by_the_gap_s_end_the_vehicle_stands_still() -> None:
    """What was asked before it is not asked after it: the target has not been seen since."""
    log = steps([0.0, 1.0, DAY_S])
    last = [record for record in log.controls if record.time_s < DAY_S][-1]
    assert last.allowed.values == pytest.approx((0, 0, 0, 0), abs=1e-3)


def test_a_lens_for_frames_of_another_size_is_refused() -> None:
    settings = load_settings(overrides=["camera.frame_size=[640,480]"])
    with pytest.raises(SettingsError, match=r"frames are 160x120, camera\.frame_size says 640x480"):
        steps([0.0, 0.1], settings)
    fitting = load_settings(overrides=[f"camera.frame_size=[{WIDTH},{HEIGHT}]"])
    assert len(steps([0.0, 0.1], fitting).controls) == math.ceil(0.1 / 0.02) + 1
