"""`follower inspect`: what the report says of a whole, a cut, a foreign and an empty recording."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from html_page import Page
from program import output_of
from rewritten_flight import configured_anew, logged_anew
from rich.console import Console

from follower.apps.inspect import inspect_flight, summary
from follower.flight.log import FlightLog, TrackRecord
from follower.flight.supervision.flight_end import NOT_BEGUN
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.recording import open_flight
from follower.report.series import LoggedFlight
from follower.report.track_losses import losses, pick_images, wanted_frames
from follower.tuning.identify.readers import read_flight
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import Track, TrackState


def inspected(folder: Path) -> tuple[Page, str]:
    """Return the page and what was printed."""
    printed = io.StringIO()
    path = inspect_flight(folder, console=Console(file=printed, width=100))
    page = Page(path.read_text("utf-8"))
    assert page.open == []
    return page, printed.getvalue()


@pytest.fixture(scope="module")
def whole(small_flight: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Page, str]:
    folder = tmp_path_factory.mktemp("inspected") / "small"
    shutil.copytree(small_flight.folder, folder)
    return inspected(folder)


@pytest.mark.slow
def test_the_report_shows_what_a_flight_was(whole: tuple[Page, str]) -> None:
    page, printed = whole
    wanted = {
        "States",
        "Target not seen",
        "Track error",
        "Map",
        "Delays and ages",
        "Recording",
        "Events",
    }
    wanted.add("Pilot, gimbal and health")
    assert wanted <= set(page.headings)
    assert "touché: “ende”" in page.text
    assert "waiting" in page.text or "target seen" in page.text
    assert "Target seen" in printed
    assert "following" in printed


@pytest.mark.slow
def test_the_report_needs_nothing_from_elsewhere(whole: tuple[Page, str]) -> None:
    page, _ = whole
    files = {"flight.mcap", "mavlink.tlog", "video.mkv", "config.yaml"}
    for target in page.loads:
        assert target.startswith(("data:", "#")) or target in files


@pytest.mark.slow
def test_a_truncated_flight_is_reported_up_to_where_it_ends(
    small_flight: Any, tmp_path: Path
) -> None:
    folder = tmp_path / "cut"
    shutil.copytree(small_flight.folder, folder)
    log = folder / "flight.mcap"
    log.write_bytes(log.read_bytes()[: int(0.6 * log.stat().st_size)])
    assert not open_flight(folder).whole
    page, printed = inspected(folder)
    assert "cut off" in page.text
    assert "cut off" in printed
    assert "States" in page.headings


@pytest.mark.slow
def test_how_a_flight_ended_is_open_where_its_log_is_cut_off(small_flight: Any) -> None:
    recorded = open_flight(small_flight.folder)
    assert recorded.whole
    idle = {"state": SupervisorState.IDLE, "reason": SupervisorReason.NO_TARGET}
    recorded.log.controls[:] = [replace(recorded.log.controls[0], **idle)]
    for whole, end in ((True, NOT_BEGUN.sentence), (False, "not recorded")):
        recorded.whole = whole
        assert dict(summary(recorded, LoggedFlight(recorded.log), []))["End"] == end


@pytest.mark.slow
def test_a_flight_without_its_video_is_reported_without_pictures(
    small_flight: Any, tmp_path: Path
) -> None:
    folder = tmp_path / "blind"
    shutil.copytree(small_flight.folder, folder)
    (folder / "video.mkv").unlink()
    page, said = inspected(folder)
    assert not any(target.startswith("data:") for target in page.loads)
    assert "States" in page.headings
    assert "video.mkv: it is missing." in said


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"servo": 3, "camera": None},
        {
            "servo": {"target_size_m": "x", "distance_m": [], "elevation_deg": {}},
            "camera": {"pitch_deg": True, "latency_s": "x"},
            "recorder": 1,
        },
    ],
)
def test_settings_of_another_form_are_passed_over(
    small_flight: Any, tmp_path: Path, settings: dict[str, Any]
) -> None:
    """As of another version."""

    def edit(config: dict[str, Any]) -> None:
        config["settings"] = settings

    folder = configured_anew(small_flight.folder, tmp_path / "flight", edit)
    assert inspect_flight(folder).is_file()
    read_flight(folder)


@pytest.mark.slow
def test_the_report_goes_where_it_is_wanted(small_flight: Any, tmp_path: Path) -> None:
    out = tmp_path / "here.html"
    output_of("inspect", str(small_flight.folder), "--out", str(out))
    assert out.is_file()
    assert not (small_flight.folder / "inspection.html").exists()


def record(number: int, state: TrackState | None) -> TrackRecord:
    time_s = 10 + number / 10
    box = Box(50, 40, 20, 10)
    track = None if state is None else Track(box, state, 0.5, "test", time_s, number)
    return TrackRecord(track, number, time_s, time_s, time_s, 0.0)


def flight_of(states: str) -> LoggedFlight:
    """Make a flight of a letter a frame: t(racking), c(oasting), l(ost), n(one)."""
    names = {"t": TrackState.TRACKING, "c": TrackState.COASTING, "l": TrackState.LOST, "n": None}
    return LoggedFlight(FlightLog([record(n, names[letter]) for n, letter in enumerate(states)]))


def test_losses_begin_with_the_first_frame_unseen_and_end_with_the_next_one_seen() -> None:
    (one,) = losses(flight_of("nntttcclltt"))
    assert (one.start_s, one.end_s) == (pytest.approx(0.5), pytest.approx(0.9))
    assert one.said == "coasting, lost"
    assert one.seen_before.sequence == 4
    assert one.seen_again.sequence == 9


def test_before_the_first_sight_nothing_is_lost() -> None:
    assert losses(flight_of("nnnn")) == []
    assert losses(flight_of("nnttt")) == []
    assert losses(flight_of("")) == []


def test_a_loss_at_the_end_has_no_end() -> None:
    first, last = losses(flight_of("tctlll"))
    assert first.seen_again is not None
    assert last.seen_again is None
    assert [word for word, _ in last.shown_records] == ["seen last", "unseen"]


def test_a_target_that_is_given_up_is_not_lost() -> None:
    assert losses(flight_of("ttnnntt")) == []
    (one,) = losses(flight_of("tllnnntt"))
    assert (one.start_s, one.end_s) == (pytest.approx(0.1), pytest.approx(0.2))
    assert (one.said, one.seen_again) == ("lost", None)


def test_only_the_wanted_pictures_are_read() -> None:
    found = losses(flight_of("ttcctttt"))
    read: list[int] = []

    def frames() -> Any:
        for number in range(8):
            read.append(number)
            yield Frame(np.zeros((8, 8, 3), np.uint8), number / 10, number)

    wanted = wanted_frames(found)
    assert set(pick_images(frames(), wanted)) == wanted == {1, 3, 4}
    assert read == [0, 1, 2, 3, 4]


def test_where_nothing_was_sent_there_is_no_delay_to_the_setpoint(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    assert "Capture to setpoint, median" in dict(summary(flight, LoggedFlight(flight.log), []))
    unsent = [replace(one, sent=False) for one in flight.log.controls]
    flight.log.controls = unsent
    assert "Capture to setpoint, median" not in dict(summary(flight, LoggedFlight(flight.log), []))


def test_an_imported_video_has_no_end_of_a_flight(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    assert "End" in dict(summary(flight, LoggedFlight(flight.log), []))
    video = replace(flight, config=replace(flight.config, kind="video"))
    assert "End" not in dict(summary(video, LoggedFlight(flight.log), []))


@pytest.mark.slow
def test_a_target_that_was_never_seen_was_not_seen_in_every_frame(
    small_flight: Any, tmp_path: Path
) -> None:
    def lost(message: object) -> object:
        if isinstance(message, TrackRecord) and message.track is not None:
            return replace(message, track=replace(message.track, state=TrackState.LOST))
        return message

    folder = logged_anew(small_flight.folder, tmp_path / "flight", lost)
    page, _ = inspected(folder)
    assert "The target was never seen." in page.text
    assert "seen in every frame" not in page.text


@pytest.mark.slow
@pytest.mark.parametrize("is_folder", [False, True])
def test_a_damaged_tlog_is_in_the_headline_and_told_once(
    small_flight: Any, tmp_path: Path, is_folder: bool
) -> None:
    folder = Path(shutil.copytree(small_flight.folder, tmp_path / "flight"))
    tlog = folder / "mavlink.tlog"
    data = tlog.read_bytes()[:-5]
    tlog.unlink()
    if is_folder:
        tlog.mkdir()
        said = "mavlink.tlog cannot be read: Is a directory."
    else:
        tlog.write_bytes(data)
        said = "bytes of mavlink.tlog are cut off"
    flight = open_flight(folder)
    for _ in range(2):  # as where the folder has no room for the report
        list(flight.packets())
    assert len(flight.remarks) == 1
    page, printed = inspected(folder)
    assert "with parts missing" in page.text
    assert printed.count(said) == 1
