"""A flight of hours does not fill the memory; its recording has all of it."""

from __future__ import annotations

from pathlib import Path

from follower.flight.log import TrackRecord
from follower.recording import FlightConfig, Recorder
from follower.recording.recorded_flight import open_flight
from follower.settings.settings import Settings
from follower_vision.clock import SimulatedClock

KEPT = 10
TRACKS = 95


def test_memory_keeps_the_newest_and_the_recording_keeps_all(tmp_path: Path) -> None:
    config = FlightConfig.of("simulated", Settings())
    with Recorder(tmp_path, config, SimulatedClock(), threaded=False, kept=KEPT) as recorder:
        for number in range(TRACKS):
            recorder.log.add_track(TrackRecord(None, number, 0.1 * number, 0.0, 0.0, 0.0))
            held = [record.sequence for record in recorder.log.tracks]
            assert held[-1] == number
            assert min(number + 1, KEPT) <= len(held) <= 2 * KEPT
            assert held == list(range(held[0], number + 1))
    assert [record.sequence for record in open_flight(tmp_path).log.tracks] == list(range(TRACKS))


def test_what_is_said_does_not_fill_the_memory_either(tmp_path: Path) -> None:
    config = FlightConfig.of("simulated", Settings())
    with Recorder(tmp_path, config, SimulatedClock(), threaded=False, kept=KEPT) as recorder:
        for number in range(TRACKS):
            recorder.log.note(0.1 * number, "operator", f"stop, by {number}")
        assert recorder.log.events[-1].text == f"stop, by {TRACKS - 1}"
        assert len(recorder.log.events) <= 2 * KEPT
    assert len(open_flight(tmp_path).log.events) == TRACKS
