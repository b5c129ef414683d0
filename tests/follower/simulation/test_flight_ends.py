"""What `follower sim` says at the end, and its exit code, when others took the vehicle."""

import io
import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from rich.console import Console

from follower.flight.supervision.flight_end import HANDED_OVER, FlightEnd
from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.settings import load_settings, scenario_files
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import VisionSource
from follower.simulation.report import report_flight
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import Track

TAKEN_OVER_S = 20.0


class Corner:
    """A `FlightVideo` that keeps what is written into the pictures."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def add(self, _frame: Frame, _tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Take a frame's lines."""
        self.texts.append("\n".join(lines))


def flown(scenario: Scenario, corner: Corner) -> SimulatedFlight:
    """Fly until the pilot takes the vehicle back, who never returns it."""
    clock, extras = SimulatedClock(), FlightOptions(video=corner, vision=VisionSource.TRUTH)
    settings = load_settings(base=base_settings(scenario))
    world, ends = World(scenario), MemoryTransport.pair()
    flight = SimulatedFlight(world, settings, "px4", clock, ends, extras)

    def take_over() -> None:
        following = flight.stage.supervisor.state is SupervisorState.FOLLOWING
        if following and clock.now() > TAKEN_OVER_S and flight.autopilot is not None:
            flight.autopilot.switch_mode("POSCTL")

    fly_lockstep(flight, clock, take_over)
    return flight


@pytest.mark.slow
def test_after_the_pilots_takeover_the_end_says_so_and_nothing_later_is_scored(
    tmp_path: Path,
) -> None:
    corner = Corner()
    flight = flown(load_scenario(scenario_files()["winding"]), corner)
    written = io.StringIO()
    console = Console(file=written, width=100)
    end = report_flight(flight, flight.score(), tmp_path, "", "px4", "", (), console)
    assert end == FlightEnd("Handed over to the pilot, who took another mode", HANDED_OVER)
    assert end.sentence in written.getvalue()
    assert "The pursuit" not in written.getvalue()
    assert end.sentence in (tmp_path / "report.html").read_text("utf-8")
    assert json.loads((tmp_path / "score.json").read_text("utf-8"))["run"]["end"] == end.sentence
    score = flight.score()
    assert score.approach_s is not None
    assert score.following_share is not None
    assert score.following_share > 0.99
    assert score.losses == 0
    ranged = {text.split()[2] for text in corner.texts if "range" in text}
    assert ranged == {"FOLLOWING"}, "of nothing else a range is fresh"
    assert any("RELEASED" in text for text in corner.texts)
