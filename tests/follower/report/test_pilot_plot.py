"""Sticks, consent, gimbal and health in the inspection's page."""

import math
from dataclasses import replace

import numpy as np
import pytest

from follower.flight.log import ControlRecord, FlightLog
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.links.vehicle_health import EstimatorHealth, SensorHealth, VehicleHealth
from follower.report import style
from follower.report.pilot_plot import channels, gimbal_angles, health, pilot_and_vehicle
from follower.report.series import LoggedFlight
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import Attitude, GimbalState, RcChannels, VehicleState

UNCHOSEN = SupervisorState.IDLE, SupervisorReason.NO_TARGET
EMPTY = ControlRecord(
    *(0.0, 0.0, 0.0, *UNCHOSEN, None, None, VehicleState(), HOLD, HOLD, ()), sent=False
)
HELD = GimbalState(Attitude(0.0, math.radians(-30), math.radians(10), 0.0, 0.0, 0.0, 0.5))
TOLD = VehicleHealth(
    sensors=SensorHealth(0, 0, 0.8, 0.5),
    estimator=EstimatorHealth(0, 0.1, 0.4, 0.2, 0.3, False, 0.5),
)


def flight(*records: ControlRecord) -> LoggedFlight:
    log = FlightLog()
    log.controls.extend(records)
    return LoggedFlight(log)


def test_nothing_known_draws_nothing() -> None:
    assert pilot_and_vehicle(flight(EMPTY, replace(EMPTY, time_s=1.0))) is None


def test_each_thing_known_has_its_panel() -> None:
    heard = RcChannels((1500, 1100, 0, 1900), 1.0)
    records = [
        replace(EMPTY, time_s=float(n), vehicle=VehicleState(rc=heard, gimbal=HELD), health=TOLD)
        for n in range(3)
    ]
    with style.plot_style():
        drawn = pilot_and_vehicle(flight(*records))
    names = [axes.get_ylabel() for axes in drawn.axes]
    assert names == ["channels [µs]", "gimbal [°]", "battery [%]", "estimator"]


def test_numbers_are_those_of_the_messages_and_health_holds_until_told_anew() -> None:
    heard = RcChannels((1500, 1100, 0, 1900), 0.0)
    records = (
        EMPTY,
        replace(EMPTY, vehicle=VehicleState(rc=heard, gimbal=HELD), health=TOLD),
        EMPTY,
    )
    pulses = channels(records)
    assert pulses.shape == (3, 8)
    assert pulses[1, :4] == pytest.approx((1500, 1100, math.nan, 1900), nan_ok=True)
    assert np.isnan(pulses[[0, 2]]).all()
    assert gimbal_angles(records)[1] == pytest.approx((10.0, -30.0))
    assert health(records)[0] == pytest.approx((math.nan, math.nan), nan_ok=True)
    assert health(records)[2] == pytest.approx((80.0, 0.4))
