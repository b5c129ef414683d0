"""Recorded flights, sound and broken on purpose, replayed through the real pipeline.

tests/golden holds three short simulated flights; `make golden` flies them anew. All have pixels.
OpenCV and the trackers' matrix products choose their code by the processor, and a tracker's
rounding errors grow: of vision, the outcome is compared, within the tolerances below. They are
about twice what OpenBLAS' kernels, and NumPy and OpenCV without AVX, make of these flights. Control
is fed the recorded tracks and compared as `follower replay` does: bit for bit on the kind of
machine that recorded them, within 1e-9 elsewhere.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

from follower.apps.replay.comparison import Strictness, compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.log import ControlRecord, FlightLog, TrackRecord
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.recording import RecordedFlight, open_flight
from follower.recording.mcap_writer import McapLog
from follower.recording.messages import FrameRecord, StepRecord
from follower_control.vehicle.state import Attitude, VehicleState

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parents[2] / "golden"
FLIGHTS = ("chase", "blackout", "watch")
BROKEN_S = 12.0
"""When things begin to go wrong; by then every flight follows its target."""

LEAST_OVERLAP = 0.9
"""Intersection over union of a replayed box with the recorded one, in every frame."""
MOST_APART_M_S, MEAN_APART_M_S = 0.5, 0.1
"""How far a component of the velocity may be off, at any time and on average."""
MOST_APART_RAD_S = 0.02
"""The same for the yaw rate."""
LATE_STEPS = 2
"""So many control steps may have decided otherwise, in all."""

Messages: TypeAlias = Iterator[tuple[float, object]]
Edit: TypeAlias = Callable[[Messages], Messages]


def replayed(flight: RecordedFlight) -> FlightLog:
    return Replay(flight, replay_settings(flight)).run()


@dataclass(frozen=True)
class Golden:
    """A flight and copies of it in which something is broken."""

    flight: RecordedFlight
    folder: Path

    def broken(self, edit: Edit) -> RecordedFlight:
        config = self.flight.config
        (self.folder / "flight.mcap").unlink(missing_ok=True)
        with McapLog(self.folder / "flight.mcap", config.epoch_ns, config.to_yaml()) as log:
            for time_s, message in edit(self.flight.messages()):
                log.write(message, time_s)
        for name in ("config.yaml", "video.mkv"):
            shutil.copy(self.flight.folder / name, self.folder / name)
        return open_flight(self.folder)


@pytest.fixture
def chase(tmp_path: Path) -> Golden:
    return Golden(open_flight(GOLDEN / "chase"), tmp_path)


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_recorded_flight_is_flown_the_same_way_again(name: str) -> None:
    flight = open_flight(GOLDEN / name)
    log = replayed(flight)
    for before, now in zip(flight.log.tracks, log.tracks, strict=True):
        assert (before.track is None) == (now.track is None)
        if before.track is not None and now.track is not None:
            assert now.track.state is before.track.state
            assert now.track.box.iou(before.track.box) > LEAST_OVERLAP
    assert states(log) == states(flight.log)
    steps = list(zip(flight.log.controls, log.controls, strict=True))
    assert sum(a.reason is not b.reason for a, b in steps) <= LATE_STEPS
    apart = np.abs([np.subtract(a.allowed.values, b.allowed.values) for a, b in steps])
    assert (apart[:, :3] < MOST_APART_M_S).all()
    assert (apart[:, :3].mean(axis=0) < MEAN_APART_M_S).all()
    assert (apart[:, 3] < MOST_APART_RAD_S).all()


@pytest.mark.parametrize("name", FLIGHTS)
def test_control_alone_gives_the_recorded_setpoints(name: str) -> None:
    assert_control_replays(open_flight(GOLDEN / name))


def assert_control_replays(flight: RecordedFlight) -> None:
    """Fed the recorded tracks: to the last bit on this kind of machine, else within 1e-9."""
    replay = Replay(flight, replay_settings(flight), tracks_recorded=True)
    allowed = Strictness.of(flight).tolerance
    for one in compare(flight.log, replay.run()).control:
        assert one.largest <= allowed, one.name


def test_the_golden_flights_are_what_they_are_meant_to_be() -> None:
    chase, blackout, watch = (open_flight(GOLDEN / name) for name in FLIGHTS)
    assert any(state is SupervisorState.FOLLOWING for state in states(chase.log))
    assert max(record.allowed.forward_m_s for record in chase.log.controls) > 2.0
    assert states(blackout.log)[-2:] == [SupervisorState.HOLDING, SupervisorState.RELEASED]
    assert all(record.allowed.forward_m_s == 0 for record in watch.log.controls)
    assert max(abs(record.allowed.yaw_rate_rad_s) for record in watch.log.controls) > 0.1


def test_a_frozen_gyro_makes_it_hold(chase: Golden) -> None:
    """The attitude repeats itself while its time goes on: within 0.15 s it asks for a hold."""
    log = replayed(chase.broken(frozen))
    stale = [record for record in log.controls if record.reason is SupervisorReason.TELEMETRY_STALE]
    assert BROKEN_S < stale[0].time_s < BROKEN_S + 0.15
    assert_holds_from(log, BROKEN_S + 0.15)


def test_late_telemetry_is_never_mistaken_for_new(chase: Golden) -> None:
    """200 ms late: it goes on following, by attitudes of the right time, or it does not steer."""
    flight = chase.flight
    log = replayed(chase.broken(late))
    assert_in_bounds(log)
    for record, sound in zip(log.controls, flight.log.controls, strict=True):
        if record.time_s > BROKEN_S + 1.0 and record.estimate and sound.estimate:
            # By an attitude of the wrong time, the turning vehicle would smear the direction.
            apart = abs(record.estimate.azimuth_rad - sound.estimate.azimuth_rad)
            assert apart < math.radians(3.0)


def test_dropped_frames_are_borne(chase: Golden) -> None:
    """Of two frames in five nothing is seen: it goes on, and the setpoints stay close.

    Whichever two: how far a single choice is off is chance.
    """
    apart: list[float] = []
    for first in range(5):
        log = replayed(chase.broken(partial(dropping, first)))
        assert len(log.tracks) < 0.8 * len(chase.flight.log.tracks)
        followed = [record for record in log.controls if BROKEN_S < record.time_s < 21.5]
        assert all(record.state is SupervisorState.FOLLOWING for record in followed)
        apart += [
            abs(record.allowed.forward_m_s - sound.allowed.forward_m_s)
            for record, sound in zip(log.controls, chase.flight.log.controls, strict=True)
        ]
    assert np.percentile(apart, 95) < 0.5


def test_times_that_jump_back_are_refused(chase: Golden) -> None:
    """Frames from a second ago are not new sightings: it lets go of the target and holds."""
    log = replayed(chase.broken(jumping_back))
    assert_in_bounds(log)
    newest = [record.estimate.last_seen_s for record in log.controls if record.estimate]
    assert newest == sorted(newest)
    late = [record for record in log.controls if BROKEN_S + 0.6 < record.time_s < BROKEN_S + 0.9]
    assert {record.reason for record in late} == {SupervisorReason.FRAMES_STALE}
    assert all(record.asked.values == (0, 0, 0, 0) for record in late)


def test_nan_in_the_attitude_goes_no_further(chase: Golden) -> None:
    """Single NaNs change next to nothing; when nothing else comes, it holds."""
    log = replayed(chase.broken(lambda messages: nan(messages, every=10)))
    assert_in_bounds(log)
    apart = [
        abs(record.allowed.yaw_rate_rad_s - sound.allowed.yaw_rate_rad_s)
        for record, sound in zip(log.controls, chase.flight.log.controls, strict=True)
    ]
    assert max(apart) < 0.05


def test_nan_alone_makes_it_hold(chase: Golden) -> None:
    """An attitude of nothing but NaN is none: within 0.6 s it asks for a hold."""
    log = replayed(chase.broken(lambda messages: nan(messages, every=1)))
    assert_in_bounds(log)
    assert_holds_from(log, BROKEN_S + 0.6)


@pytest.mark.parametrize("share", [0.3, 0.77])
def test_a_truncated_log_replays_up_to_its_end(chase: Golden, share: float) -> None:
    """What is there replays as before, and it says that something is missing."""
    data = (chase.flight.folder / "flight.mcap").read_bytes()
    (chase.folder / "flight.mcap").write_bytes(data[: int(share * len(data))])
    shutil.copy(chase.flight.folder / "video.mkv", chase.folder)
    cut = open_flight(chase.folder)
    assert 0.5 * share < len(cut.log.controls) / len(chase.flight.log.controls) < share + 0.1
    assert any("cut off" in remark for remark in cut.remarks)
    assert_control_replays(cut)


def test_a_truncated_video_leaves_the_recorded_tracks(chase: Golden) -> None:
    """Frames that are missing are counted, and control goes on by the tracks of the log."""
    data = (chase.flight.folder / "video.mkv").read_bytes()
    (chase.folder / "video.mkv").write_bytes(data[: len(data) // 2])
    for name in ("flight.mcap", "config.yaml"):
        shutil.copy(chase.flight.folder / name, chase.folder / name)
    flight = open_flight(chase.folder)
    replay = Replay(flight, replay_settings(flight))
    log = replay.run()
    assert replay.missed > 50
    assert len(log.controls) == len(chase.flight.log.controls)
    assert_in_bounds(log)


def states(log: FlightLog) -> list[SupervisorState]:
    """The states in turn, each once."""
    found: list[SupervisorState] = []
    for record in log.controls:
        if not found or record.state is not found[-1]:
            found.append(record.state)
    return found


def assert_in_bounds(log: FlightLog) -> None:
    for record in log.controls:
        forward, right, down, yaw_rate = record.allowed.values
        assert math.hypot(forward, right) <= 10.0 + 1e-6
        assert -2.0 - 1e-6 <= down <= 1.5 + 1e-6
        assert abs(yaw_rate) <= math.radians(60) + 1e-6


def assert_holds_from(log: FlightLog, time_s: float) -> None:
    after = [record for record in log.controls if record.time_s > time_s]
    assert after
    assert all(record.asked.values == (0, 0, 0, 0) for record in after)
    assert all(
        record.state in (SupervisorState.HOLDING, SupervisorState.RELEASED) for record in after
    )
    assert speed(after[-1]) < 1e-6


def speed(record: ControlRecord) -> float:
    return math.hypot(*record.allowed.values)


def frozen(messages: Messages) -> Messages:
    """Every attitude says what the last one said before."""
    last: Attitude | None = None

    def same_again(now: Attitude) -> Attitude:
        return now if last is None else replace(last, time_s=now.time_s)

    for time_s, message in messages:
        if time_s < BROKEN_S:
            last = message if isinstance(message, Attitude) else last
            yield time_s, message
        else:
            yield time_s, with_attitude(message, same_again)


def late(messages: Messages) -> Messages:
    """Attitudes come 200 ms after their time has come."""
    waiting: list[tuple[float, Attitude]] = []
    newest: Attitude | None = None

    def arrived(now: Attitude) -> Attitude:
        return newest or now

    for time_s, message in messages:
        if time_s >= BROKEN_S and isinstance(message, Attitude):
            waiting.append((time_s, message))
            continue
        while waiting and waiting[0][0] <= time_s - 0.2:
            newest = waiting.pop(0)[1]
            yield time_s, newest
        newest = message if isinstance(message, Attitude) else newest
        yield time_s, with_attitude(message, arrived)


def dropping(first: int, messages: Messages) -> Messages:
    """Two frames of five never came: control has the track before them for longer."""
    seen: TrackRecord | None = None
    for time_s, message in messages:
        gone = time_s > BROKEN_S
        pictured = isinstance(message, FrameRecord | TrackRecord)
        if gone and pictured and (message.sequence - first) % 5 < 2:
            continue
        seen = message if isinstance(message, TrackRecord) else seen
        if gone and isinstance(message, StepRecord) and seen is not None:
            message = replace(
                message, track_sequence=seen.sequence, track_captured_s=seen.captured_s
            )
        yield time_s, message


def jumping_back(messages: Messages) -> Messages:
    """The camera's clock is set back by a second."""
    for time_s, message in messages:
        if time_s > BROKEN_S and isinstance(message, FrameRecord | TrackRecord):
            message = replace(message, captured_s=message.captured_s - 1.0)
        yield time_s, message


def nan(messages: Messages, every: int) -> Messages:
    """Of so many attitudes one has NaN for its roll."""
    for number, (time_s, message) in enumerate(messages):
        if time_s > BROKEN_S and number % every == 0:
            message = with_attitude(message, lambda now: replace(now, roll_rad=math.nan))
        yield time_s, message


def with_attitude(message: object, change: Callable[[Attitude], Attitude]) -> object:
    if isinstance(message, Attitude):
        return change(message)
    if isinstance(message, VehicleState) and message.attitude is not None:
        return replace(message, attitude=change(message.attitude))
    return message
