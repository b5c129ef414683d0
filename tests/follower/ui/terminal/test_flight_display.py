"""What the terminal shows, and how often."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from follower.flight.log import FlightLog
from follower.flight.status import LiveStatus
from follower.flight.supervision.flight_end import pursuit_end
from follower.simulation.ground_truth import score_flight
from follower.simulation.report import print_score
from follower.ui.terminal.console import print_line
from follower.ui.terminal.flight_display import FlightDisplay, plain_line, status_table
from follower_control.servo.pursuit_state import ServoErrors
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_sim.scenario.scenario import Criteria
from follower_sim.scoring.criteria import verdict
from follower_vision.clock import SimulatedClock

STATUS = LiveStatus(
    elapsed_s=12.34,
    total_s=60.0,
    state="following",
    reason="target seen",
    phase="following",
    azimuth_error_rad=math.radians(2.0),
    elevation_error_rad=math.radians(-1.5),
    range_m=15.25,
    asked=VelocitySetpoint(6.0, 0.0, -1.0, math.radians(10)),
    allowed=VelocitySetpoint(5.0, 0.0, -1.0, math.radians(9)),
    flown=VelocitySetpoint(4.0, 3.0, 0.0, math.radians(-8)),
    track="tracking",
    confidence=0.87,
    frame_rate_hz=30.0,
    vision_s=0.0046,
    control_s=0.00023,
    late_s=0.0001,
)


def text_of(draw: Callable[[Console], None], *, terminal: bool = False) -> str:
    buffer = io.StringIO()
    draw(Console(file=buffer, force_terminal=terminal, width=120, no_color=True))
    return buffer.getvalue()


def test_the_table_shows_degrees_and_up_as_positive() -> None:
    text = text_of(lambda console: console.print(status_table(STATUS, "A car")))
    for part in ("A car", "FOLLOWING", "target seen", "+2.0°", "-1.5°", "15.2 m", "12.3 of 60 s"):
        assert part in text
    assert "up  +1.00" in text
    assert "+10.0 °/s" in text
    assert "0.87" in text
    assert "30 frames/s" in text
    assert "4.6 ms" in text
    assert "0.23 ms" in text
    assert "0.10 ms late" in text


def test_the_plain_line_is_one_line_with_the_same_numbers() -> None:
    line = plain_line(STATUS)
    assert "\n" not in line
    for part in ("12.3/60 s", "following", "+2.0°", "15.2 m", "5.1 m/s", "5.0 m/s -8 °/s"):
        assert part in line


def test_what_is_not_known_is_a_dash_and_never_a_number() -> None:
    empty = LiveStatus(0.0)
    assert "–" in plain_line(empty)
    text = text_of(lambda console: console.print(status_table(empty)))
    assert "None" not in text
    assert "nan" not in text


def test_nothing_is_shown_as_minus_zero() -> None:
    still = VelocitySetpoint(-0.0, -0.0, 0.0, -0.0)
    status = LiveStatus(0.0, asked=still, allowed=still, flown=still)
    text = text_of(lambda console: console.print(status_table(status)))
    assert "-0.0" not in text


def show_for(duration_s: float, period_s: float, *, terminal: bool) -> str:
    clock = SimulatedClock()

    def draw(console: Console) -> None:
        with FlightDisplay(console, "A car", clock) as display:
            while clock.now() < duration_s:
                display.show(STATUS)
                clock.sleep_until(clock.now() + period_s)

    return text_of(draw, terminal=terminal)


def test_a_pipe_gets_a_line_every_five_seconds() -> None:
    lines = show_for(21.0, 0.02, terminal=False).splitlines()
    assert lines[0] == "A car"
    assert len(lines) == 1 + 5
    assert not any("\x1b" in line for line in lines)


def test_a_terminal_is_redrawn_ten_times_a_second() -> None:
    assert show_for(1.0, 0.02, terminal=True).count("FOLLOWING") == pytest.approx(11, abs=2)


def test_a_pipe_gets_each_change_of_state_at_once() -> None:
    clock = SimulatedClock()

    def draw(console: Console) -> None:
        with FlightDisplay(console, "", clock) as display:
            for state in ("ready", "following", "following", "coasting"):
                display.show(LiveStatus(clock.now(), state=state))
                clock.sleep_until(clock.now() + 0.1)

    assert len(text_of(draw).splitlines()) == 3


def test_a_line_said_stays_as_it_was_written() -> None:
    def draw(console: Console) -> None:
        with FlightDisplay(console) as display:
            display.say("[bold]autopilot[/bold]: armed")

    assert "[bold]autopilot[/bold]: armed" in text_of(draw)


def test_an_error_inside_gives_the_terminal_back() -> None:
    buffer = io.StringIO()
    console = Console(file=buffer, force_terminal=True)

    def interrupted() -> None:
        with FlightDisplay(console) as display:
            display.show(STATUS)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    hide, show_again = "\x1b[?25l", "\x1b[?25h"
    assert buffer.getvalue().rfind(show_again) > buffer.getvalue().rfind(hide)


def test_the_status_of_a_log_is_its_newest_moment(fly: Any) -> None:
    log = fly(20.0).log
    log = FlightLog(log.tracks[:240], log.controls[:400])
    errors = ServoErrors(0.1, -0.2, 0.3, 17.0, 4.0)
    status = LiveStatus.of(log, start_s=1000.0, total_s=60.0, errors=errors, phase="following")
    assert status.elapsed_s == pytest.approx(399 * 0.02)
    assert status.state == "following"
    assert (status.azimuth_error_rad, status.range_m) == (0.1, 17.0)
    assert status.frame_rate_hz == pytest.approx(30, abs=1)
    assert status.allowed == log.controls[-1].allowed
    assert status.track == "tracking"


def test_what_vision_said_long_ago_is_not_told_as_the_present(fly: Any) -> None:
    log = fly(20.0).log
    status = LiveStatus.of(FlightLog(log.tracks[:240], log.controls[:500]), 1000.0)
    assert (status.track, status.confidence, status.vision_s) == ("", None, None)
    assert status.frame_rate_hz == 0.0


def test_errors_are_shown_only_while_the_servo_steers(fly: Any) -> None:
    log = fly(20.0).log
    ready = FlightLog(log.tracks[:135], log.controls[:225])
    status = LiveStatus.of(ready, 1000.0, errors=ServoErrors(0.1, -0.2, 0.3, 17.0, 4.0))
    assert status.state == "ready"
    assert status.azimuth_error_rad is None
    assert status.range_m is None


def test_an_empty_log_has_a_status() -> None:
    status = LiveStatus.of(FlightLog(), 0.0, 60.0)
    assert (status.state, status.frame_rate_hz, status.total_s) == ("idle", None, 60.0)


def test_the_final_table_names_failures_and_files(fly: Any) -> None:
    flight = fly(20.0)
    score = score_flight(flight.log, flight.truth, flight.goal)
    files, end = [Path("runs/demo/report.html")], pursuit_end(verdict(score, Criteria()))
    text = text_of(lambda console: print_score(console, score, Criteria(), files, end))
    assert "The pursuit failed" in text
    assert "approach was never over" in text
    assert "runs/demo/report.html" in text
    assert "Target in frame" in text


def test_a_path_is_printed_whole_that_it_can_be_copied() -> None:
    written, path = io.StringIO(), Path("/data/[red]flights[/red]") / ("x" * 60) / "a.yaml"
    print_line(Console(file=written, width=40), f"Next: follower tune '{path}'", "bold red")
    assert written.getvalue() == f"Next: follower tune '{path}'\n"
