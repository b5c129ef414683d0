"""Whether the vehicle is well enough, by what it told of itself."""

from dataclasses import replace

import pytest

from follower.flight.supervision.inputs import HealthVerdict, judge
from follower.links.vehicle_health import (
    EstimatorHealth,
    GpsHealth,
    SensorHealth,
    VehicleHealth,
)
from follower.settings.supervisor import HealthSettings

NOW = 100.0
SETTINGS = HealthSettings()
WELL = VehicleHealth(
    sensors=SensorHealth(0x3F, 0x3F, 0.8, NOW),
    gps=GpsHealth(3, 12, 0.8, NOW),
    estimator=EstimatorHealth(0x33F, 0.1, 0.1, 0.1, 0.1, False, NOW),
)
FINE = HealthVerdict()
LOW, POOR = HealthVerdict(battery_low=True), HealthVerdict(navigation_poor=True)


def battery(share: float | None) -> VehicleHealth:
    return replace(WELL, sensors=replace(WELL.sensors, battery_share=share))


def estimator(**changes: object) -> VehicleHealth:
    return replace(WELL, estimator=replace(WELL.estimator, **changes))


@pytest.mark.parametrize(
    ("health", "engaged", "verdict"),
    [
        (VehicleHealth(), False, FINE),
        (WELL, False, FINE),
        (battery(0.25), False, LOW),
        (battery(0.25), True, FINE),
        (battery(0.15), True, LOW),
        (battery(None), False, FINE),
        (replace(WELL, gps=replace(WELL.gps, fix_type=2)), True, POOR),
        (estimator(flags=0x33F & ~2), True, POOR),
        (estimator(flags=0x33F & ~0x18), True, POOR),
        (estimator(flags=0x33F & ~0x10), True, FINE),
        (estimator(flags=0x33F | 0x80), True, POOR),
        (estimator(horizontal_ratio=1.2), True, POOR),
        (estimator(velocity_ratio=float("nan")), True, POOR),
        (estimator(vertical_ratio=1.2), True, FINE),
        (estimator(gps_glitch=True), True, POOR),
    ],
)
def test_verdicts(health: VehicleHealth, engaged: bool, verdict: HealthVerdict) -> None:
    assert judge(health, SETTINGS, engaged, NOW) == verdict


def test_what_was_told_long_ago_is_no_objection() -> None:
    old = estimator(flags=0)
    assert judge(old, SETTINGS, True, NOW + 4.9) == POOR
    assert judge(old, SETTINGS, True, NOW + 5.1) == FINE


def test_without_gps_nothing_is_asked_of_it() -> None:
    indoors = replace(WELL, gps=replace(WELL.gps, fix_type=0))
    assert judge(indoors, HealthSettings(gps_fix=None), True, NOW) == FINE
