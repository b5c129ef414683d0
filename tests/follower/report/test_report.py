"""The report: whole, self-contained, true to the log, and there whatever the log holds."""

from __future__ import annotations

import json
import math
import os
import re
import resource
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import pytest
from html_page import Page

from follower.flight.log import FlightLog, setpoint_delays
from follower.recording.recorded_flight import arrays
from follower.report.figures import write_track_plot
from follower.report.flight_page import write_report, write_score
from follower.report.html import table
from follower.report.series import (
    LoggedFlight,
    ReportMeta,
    believed_ranges,
    directions,
    estimated_target,
    setpoints,
    state_spans,
    telemetry_motion,
    thinned,
    true_motion,
)
from follower.simulation.ground_truth import score_flight, stopped_s
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import Attitude, LocalPosition
from follower_sim.kinematics import TruthSample
from follower_sim.scenario.scenario import Criteria
from follower_sim.scoring.score import PursuitGoal, PursuitScore
from follower_vision.disk import write_whole
from follower_vision.geometry.line_of_sight import LineOfSight

if TYPE_CHECKING:
    from playwright.sync_api import Browser

META = ReportMeta(
    title="A car <on> a winding road",
    subtitle="px4, seed 1",
    command="follower sim winding --seed 1 && echo 'done'",
    settings_yaml="servo:\n  distance_m: 15.0\n",
    facts=(("Seed", "1"),),
    files=(("score.json", "the score"),),
)
SECTIONS = (
    "Score",
    "States",
    "Track error",
    "Range and height",
    "Commanded and flown velocity",
    "Tilt",
    "Box in the image",
    "Map",
    "Timing",
    "Envelope interventions",
    "Events",
    "This run",
)


@pytest.fixture(scope="module")
def flight(fly: Any) -> Any:
    return fly(30.0)


@pytest.fixture(scope="module")
def score(flight: Any) -> PursuitScore:
    return score_flight(flight.log, flight.truth, flight.goal, overlaps=[0.7, 0.8])


@pytest.fixture(scope="module")
def html(flight: Any, score: PursuitScore, tmp_path_factory: pytest.TempPathFactory) -> str:
    return write_flight(tmp_path_factory.mktemp("report"), flight, score)


def write_flight(folder: Path, flight: Any, score: PursuitScore) -> str:
    path = write_report(
        folder,
        flight.log,
        META,
        truth=flight.truth,
        goal=flight.goal,
        score=score,
        criteria=Criteria(),
        servo=flight.servo,
    )
    return path.read_text("utf-8")


def report_page(
    folder: Path,
    log: FlightLog,
    truth: Sequence[TruthSample] = (),
    goal: PursuitGoal | None = None,
) -> Page:
    score = score_flight(log, truth, goal or PursuitGoal(None))
    path = write_report(folder, log, META, score=score, criteria=Criteria(), truth=truth, goal=goal)
    return Page(path.read_text("utf-8"))


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


@pytest.mark.slow
def test_the_page_is_well_formed_and_has_each_section(page: Page) -> None:
    assert page.open == []
    assert tuple(page.headings) == SECTIONS


@pytest.mark.slow
def test_on_a_phone_every_table_is_read_without_scrolling_sideways(
    browser: Browser, html: str
) -> None:
    head = ("tracker", "start", "auc", "success@0.5", "precision@20", "norm. prec.", "fps", "<ms>")
    row = ("a tracker with a long name", "ope", *6 * ("0.123",))
    phone = browser.new_page(viewport={"width": 390, "height": 844})
    phone.set_content(html.replace("</main>", f"{table(head, [row], range(2, 8))}</main>"))
    wide = phone.eval_on_selector_all(
        ".table",
        "all => all.filter(one => one.scrollWidth > one.clientWidth).map(one => one.innerText)",
    )
    assert wide == []
    cell = "getComputedStyle(document.querySelector('.wide td:last-child'), '::before').content"
    assert phone.evaluate(cell) == '"<ms>"'
    phone.set_viewport_size({"width": 1280, "height": 844})
    assert phone.evaluate(cell) == "none"


def test_the_page_loads_nothing_from_elsewhere(html: str, page: Page) -> None:
    assert not re.search(r"https?://", html)
    assert all(target.startswith("#") or target == "score.json" for target in page.loads)
    assert "@import" not in html
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", html))


def test_each_reference_within_the_page_has_its_target_once(html: str, page: Page) -> None:
    assert len(set(page.ids)) == len(page.ids)
    wanted = {target[1:] for target in page.loads if target.startswith("#")}
    wanted |= set(re.findall(r"url\(#([^)]*)\)", html))
    assert wanted <= set(page.ids)


def test_plots_take_their_colours_from_the_page(html: str, page: Page) -> None:
    assert len(page.plots) == 8
    for svg in re.findall(r"<svg.*?</svg>", html, re.DOTALL):
        assert set(re.findall(r"#[0-9a-f]{6}\b", svg)) <= {"#000000", "#ffffff"}
        for name in re.findall(r"var\(--(\w+)\)", svg):
            assert f"--{name}:" in html


def test_text_is_escaped(html: str, page: Page) -> None:
    assert "A car <on>" not in html
    assert "Takeoff <complete>" not in html
    assert "A car <on> a winding road" in page.text
    assert "Takeoff <complete> & hovering" in page.text


def test_the_page_says_what_was_measured(page: Page, score: PursuitScore) -> None:
    assert score.line_of_sight_rms_deg is not None
    assert f"{score.line_of_sight_rms_deg:.2f}°" in page.text
    assert "waiting for the pilot's mode" in page.text
    assert "acceleration" in page.text
    assert META.command in page.text
    assert META.settings_yaml in page.text


def test_the_headline_follows_the_verdict(score: PursuitScore, tmp_path: Path) -> None:
    for criteria, headline in (
        (Criteria(max_line_of_sight_rms_deg=1e-6), "The pursuit failed"),
        (Criteria(None, None, None, None, None, None, None), "The pursuit succeeded"),
    ):
        write_report(tmp_path, FlightLog(), META, score=score, criteria=criteria)
        assert headline in (tmp_path / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_the_same_flight_gives_the_same_page_and_leaves_matplotlib_alone(
    flight: Any, score: PursuitScore, html: str, tmp_path: Path
) -> None:
    before = dict(mpl.rcParams)
    again = write_flight(tmp_path, flight, score)
    assert again == html
    assert dict(mpl.rcParams) == before


@pytest.mark.slow
def test_a_flight_without_truth_or_telemetry_still_shows_track_and_setpoints(
    fly: Any, tmp_path: Path
) -> None:
    log = fly(10.0, telemetry=False).log
    page = report_page(tmp_path, log)
    assert "Box in the image" in page.headings
    assert "Track error" in page.headings
    assert "Commanded and flown velocity" in page.headings
    assert "Map" not in page.headings


@pytest.mark.slow
@pytest.mark.parametrize(("count", "with_truth"), [(0, False), (1, False), (1, True), (2, True)])
def test_a_log_of_hardly_anything_makes_a_report(
    flight: Any, count: int, with_truth: bool, tmp_path: Path
) -> None:
    whole = flight.log
    log = FlightLog(whole.tracks[-count:][:count], whole.controls[:count], whole.events[:count])
    truth = flight.truth[:count] if with_truth else []
    page = report_page(tmp_path, log, truth, flight.goal)
    assert page.open == []
    assert "The target was never followed" in page.text
    write_track_plot(tmp_path / "track.png", log)


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["tracks", "controls"])
def test_a_missing_part_of_the_log_is_left_out(flight: Any, missing: str, tmp_path: Path) -> None:
    log = replace(flight.log, **{missing: []})
    page = report_page(tmp_path, log, flight.truth)
    assert page.open == []
    assert "Timing" in page.headings


def test_the_score_file_holds_the_score(score: PursuitScore, tmp_path: Path) -> None:
    run = {"scenario": "winding", "seed": 1}
    path = write_score(tmp_path, score, Criteria(max_losses=0), run)
    content = json.loads(path.read_text("utf-8"))
    assert content["score"] == score.to_dict()
    assert content["criteria"]["max_losses"] == 0
    assert content["run"] == run
    assert content["passed"] is False
    assert any(line.startswith("Searches begun: 1") for line in content["failures"])


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = write_whole(tmp_path / "report.html", "old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5, before[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            write_whole(path, "half of it")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text("utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_beside_no_files_is_named_in_the_error(tmp_path: Path) -> None:
    path = write_whole(tmp_path / "notes", "no folder") / "report.html"
    with pytest.raises(NotADirectoryError) as caught:
        write_whole(path, "half of it")
    assert caught.value.filename == str(path)


def test_two_files_that_are_written_at_once_have_a_draft_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long their names: runs and their parts differ by the number at the end."""
    drafts: list[str] = []
    replace = Path.replace

    def noted(draft: Path, path: Path) -> Path:
        drafts.append(draft.name)
        return replace(draft, path)

    monkeypatch.setattr(Path, "replace", noted)
    for number in (1, 2):
        write_whole(tmp_path / f"{'n' * 200}-{number}.csv", "whole")
    assert len(set(drafts)) == 2


def test_a_file_with_the_longest_name_there_can_be_is_written(tmp_path: Path) -> None:
    path = write_whole(tmp_path / ("n" * 251 + ".csv"), "whole")
    assert path.read_text("utf-8") == "whole"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_one_and_its_file_is_written(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    link = tmp_path / "newest.csv"
    link.symlink_to(write_whole(kept / "boxes.csv", "old"))
    write_whole(link, "new")
    assert link.is_symlink()
    assert (kept / "boxes.csv").read_text("utf-8") == "new"
    assert list(kept.iterdir()) == [kept / "boxes.csv"]


def test_a_pipe_is_written_to_and_stays_one(tmp_path: Path) -> None:
    """As /dev/stdout: it was replaced by a file, where that was allowed."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_whole(pipe, "boxes")
        assert os.read(reader, 100) == b"boxes"
    finally:
        os.close(reader)
    assert pipe.is_fifo()


def test_the_track_plot_is_a_picture(flight: Any, tmp_path: Path) -> None:
    path = tmp_path / "track.png"
    write_track_plot(path, flight.log)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_directions_are_taken_from_the_nose(fly: Any) -> None:
    flight = fly(20.0)
    estimate = directions(flight.log.controls)
    truth = np.degrees([(s.azimuth_rad, s.elevation_rad) for s in flight.truth])
    known = np.isfinite(estimate).all(axis=1)
    assert known.sum() > 900
    # One step of the heading and the estimate's noise of 0.23 deg are between the two.
    assert np.abs(estimate - truth)[known].max() < 2.0


def test_flown_velocity_is_the_same_from_truth_and_telemetry(flight: Any) -> None:
    start_s = flight.log.controls[0].time_s
    true = true_motion(flight.truth, start_s)
    told = telemetry_motion(flight.log.controls, start_s)
    np.testing.assert_allclose(told.velocity, true.velocity)
    np.testing.assert_allclose(told.position_m, true.position_m)
    sample = flight.truth[-1].vehicle
    north, east, down = sample.velocity_m_s
    assert true.velocity[-1, 0] == pytest.approx(
        north * math.cos(sample.yaw_rad) + east * math.sin(sample.yaw_rad)
    )
    assert true.velocity[-1, 2] == pytest.approx(-down)


def test_setpoints_are_shown_up_and_in_degrees(flight: Any) -> None:
    row = 600
    allowed = flight.log.controls[row].allowed
    shown = setpoints(flight.log.controls, "allowed")[row]
    assert shown[2] == pytest.approx(-allowed.down_m_s)
    assert shown[3] == pytest.approx(math.degrees(allowed.yaw_rate_rad_s))


def test_states_fill_the_flight_without_gaps(flight: Any) -> None:
    spans = state_spans(flight.log.controls, flight.log.controls[0].time_s)
    assert [span.state for span in spans].count("searching") == 1
    assert spans[0].start_s == 0
    for before, after in pairwise(spans):
        assert before.end_s == after.start_s
    assert spans[-1].end_s == pytest.approx(29.98)


def test_the_approachs_end_is_drawn_where_the_score_says(flight: Any) -> None:
    score = score_flight(flight.log, flight.truth, flight.goal)
    shown = LoggedFlight(flight.log, flight.truth, flight.goal, score=score)
    if score.approach_s is None:
        assert shown.approached_s is None
    else:
        first = next(r.time_s for r in flight.log.controls if r.state == "following")
        assert shown.approached_s == pytest.approx(first - shown.start_s + score.approach_s)


def test_the_range_that_is_gone_by_is_drawn_whatever_it_is_taken_from(flight: Any) -> None:
    controls, by_size = flight.log.controls, flight.servo
    true = np.array([sample.range_m for sample in flight.truth])
    ranges = believed_ranges(controls, by_size)
    known = np.isfinite(ranges)
    assert known.sum() > 900
    assert np.median(np.abs(ranges[known] / true[: len(controls)][known] - 1)) < 0.1
    # Without a size the target is where it is wanted when it is first followed.
    guessed = believed_ranges(controls, replace(by_size, target_size_m=None))
    first = next(n for n, one in enumerate(controls) if one.estimate and one.state.steers)
    assert guessed[first] == pytest.approx(by_size.distance_m)
    np.testing.assert_allclose(guessed / guessed[first], ranges / ranges[first], rtol=1e-6)
    assert np.isnan(believed_ranges(controls, None)).all()


def test_a_range_by_the_ground_is_where_the_line_of_sight_meets_it(flight: Any) -> None:
    ground = replace(flight.servo, range_from=RangeFrom.GROUND, target_middle_m=0.5)
    ranges = believed_ranges(flight.log.controls, ground)
    for record, range_m in zip(flight.log.controls, ranges, strict=True):
        if record.estimate is not None:
            above_m = record.vehicle.position.height_m - 0.5
            assert range_m == pytest.approx(above_m / -math.sin(record.estimate.elevation_rad))


def test_thinning_keeps_the_peaks_and_the_gaps() -> None:
    time = np.arange(100_000, dtype=np.float64)
    values = np.sin(time / 5000)
    values[12_345], values[67_890] = 9.0, -9.0
    values[40_000:50_000] = np.nan
    x, y = thinned(time, values, most=1000)
    assert len(x) <= 1001
    assert np.all(np.diff(x) > 0)
    assert (np.nanmax(y), np.nanmin(y)) == (9.0, -9.0)
    assert np.isnan(y).any()


def test_a_target_below_is_seen_from_the_nose_as_any_other(flight: Any) -> None:
    """Straight down an azimuth says nothing: such an estimate is kept in angles from there."""
    away = np.array([3.0, 4.0, 12.0]) / 13
    down, east, north = away[2], away[1], away[0]
    below = LineOfSight.from_vector(np.array([down, east, -north]))
    before = next(one for one in flight.log.controls if one.estimate is not None)
    estimate = replace(
        before.estimate,
        frame=BearingFrame.DOWN,
        azimuth_rad=below.azimuth_rad,
        elevation_rad=below.elevation_rad,
        last_seen_s=before.estimate.time_s,
    )
    assert estimate.direction == pytest.approx(away)
    attitude, position = Attitude(0, 0, 0.3, 0, 0, 0, 0), LocalPosition(5, 7, -12, 0, 0, 0, 0)
    state = replace(before.vehicle, attitude=attitude, position=position)
    record = replace(before, estimate=estimate, vehicle=state)
    seen = math.degrees(math.atan2(4, 3) - 0.3), -math.degrees(math.asin(12 / 13))
    assert directions([record])[0] == pytest.approx(seen)
    row = arrays(FlightLog(controls=[record]))["controls"][0]
    assert row["azimuth_rad"] == pytest.approx(math.atan2(4, 3))
    assert row["elevation_rad"] == pytest.approx(-math.asin(12 / 13))
    settings = ServoSettings(distance_m=13.0, target_size_m=13 * math.exp(estimate.log_scale))
    assert estimated_target([record], settings)[0] == pytest.approx((8.0, 11.0))


def test_delays_count_each_frame_once_and_only_while_following(flight: Any) -> None:
    controls = flight.log.controls
    delays = setpoint_delays(controls).values()
    frames = {r.track_captured_s for r in controls if r.state == "following"}
    assert len(delays) <= len(frames)
    assert len(delays) > 0.95 * len(frames)
    assert min(delays) >= 0.05 - 1e-9
    assert max(delays) <= 0.05 + 0.02 + 1e-9


def test_the_scored_time_ends_with_the_operators_stop(flight: Any) -> None:
    assert stopped_s(flight.log.controls) == pytest.approx(1029.0)
    unsent = [replace(r, sent=False, allowed=HOLD) for r in flight.log.controls]
    log = FlightLog(flight.log.tracks, unsent, flight.log.events)
    score = score_flight(log, flight.truth, flight.goal)
    assert score.delay_median_s is None
    assert score.commanded.horizontal_acceleration_m_s2 == 0
    assert score.losses == 1
