"""What Prometheus reads of a cockpit, and what Grafana's dashboard asks Prometheus for."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import pytest
from cockpit_client import PATIENCE_S, TOKEN, get
from prometheus_client.parser import text_string_to_metric_families
from waiting import until

from follower.flight.status import LiveStatus
from follower.settings.settings import configs_folder
from follower.ui.cockpit.hub import Hub
from follower.ui.cockpit.publisher import state_message
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_vision.clock import SimulatedClock

ASKED = VelocitySetpoint(2.0, 0.5, -0.25, math.radians(10))
STATUS = LiveStatus(
    12.5,
    state="following",
    azimuth_error_rad=math.radians(3),
    range_m=17.5,
    asked=ASKED,
    track="tracking",
    confidence=0.875,
    vision_s=0.012,
)


def metrics(url: str, **headers: str) -> dict[tuple[str, ...], float]:
    """Return each sample: its name and its labels' values, and its value."""
    answer = get(f"{url}/metrics", headers=headers).raise_for_status()
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    families = text_string_to_metric_families(answer.text)
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in families
        for sample in family.samples
    }


def shown(served: Any, status: LiveStatus) -> dict[tuple[str, ...], float]:
    """Show a state, and return the metrics once they are of it."""
    served.station.show(state_message(status, None))
    wanted = (("follower_flight_time_seconds",), status.elapsed_s)
    return until(lambda: (found := metrics(served.url)).items() >= {wanted} and found)


def test_what_is_known_is_a_metric_in_base_units_and_the_rest_is_left_out(served: Any) -> None:
    found = shown(served, STATUS)
    assert found["follower_supervisor_state", "following"] == 1
    assert sum(value for name, value in found.items() if "supervisor" in name[0]) == 1
    assert found["follower_track_state", "tracking"] == 1
    assert found["follower_azimuth_error_degrees",] == pytest.approx(3)
    assert found["follower_range_meters",] == 17.5
    assert found["follower_vision_seconds",] == pytest.approx(0.012)
    assert found["follower_velocity_meters_per_second", "down", "asked"] == -0.25
    assert found["follower_yaw_rate_degrees_per_second", "asked"] == pytest.approx(10)
    assert 0 <= found["follower_state_age_seconds",] < PATIENCE_S
    told = get(f"{served.url}/api/state").json()
    assert 0 <= told["at"] - told["told_s"] < PATIENCE_S
    names = {name for name, *_ in found}
    assert names.isdisjoint({"follower_elevation_error_degrees", "follower_height_meters"})
    assert ("follower_velocity_meters_per_second", "down", "flown") not in found


def test_a_state_whose_time_stands_still_grows_old_though_it_is_told() -> None:
    clock = SimulatedClock()
    hub = Hub({}, [].append, clock, 1)
    ages_s = []
    for time_s in (0.0, 0.1, 0.1, 0.1, 0.2):
        clock.sleep_until(clock.now() + 1.0)
        hub.take({"kind": "state", "state": {"state": "following", "time_s": time_s}})
        ages_s.append(hub.state_age_s)
    assert ages_s == [0, 0, 1, 2, 0]


@pytest.mark.slow
def test_before_the_first_state_nothing_is_said_of_the_flight_and_a_token_is_wanted(
    serve: Any, tmp_path: Any
) -> None:
    (tmp_path / "token").write_text(TOKEN, "utf-8")
    served = serve(f"cockpit.token_file={tmp_path / 'token'}")
    assert get(f"{served.url}/metrics").status_code == 401
    bearer = f"Bearer {TOKEN}"
    assert metrics(served.url, authorization=bearer) == {("follower_cockpit_clients",): 0}


def test_the_dashboard_asks_for_metrics_that_there_are(served: Any) -> None:
    status = LiveStatus(
        13.5,
        azimuth_error_rad=0.1,
        elevation_error_rad=0.1,
        range_m=9.0,
        asked=ASKED,
        confidence=0.5,
        frame_rate_hz=30.0,
        vision_s=0.01,
        control_s=0.001,
    )
    names = {name for name, *_ in shown(served, status)} | {"follower_height_meters"}
    board = json.loads((configs_folder() / "viewers" / "grafana.json").read_text("utf-8"))
    asked = [target for panel in board["panels"] for target in panel["targets"]]
    used = {name for one in asked for name in re.findall(r"follower_\w+", one["expr"])}
    assert used <= names
    assert len(used) == len(names) - 3, "all but the time, armed and consent"
    labels = {label for one in asked for label in re.findall(r"{{(\w+)}}", one["legendFormat"])}
    assert labels == {"axis", "motion", "follower_supervisor_state", "follower_track_state"}
