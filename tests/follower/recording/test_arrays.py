"""A flight's log as NumPy structured arrays, and as pandas where that is installed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from follower.flight.log import FlightLog, TrackRecord
from follower.recording import RecordedFlight, open_flight
from follower.recording.recorded_flight import arrays

GOLDEN = Path(__file__).parents[2] / "golden" / "chase"


@pytest.fixture(scope="module")
def flight() -> RecordedFlight:
    return open_flight(GOLDEN)


@pytest.mark.slow
def test_each_record_is_a_row_with_its_numbers_to_the_last_bit(flight: RecordedFlight) -> None:
    tables, log = flight.arrays(), flight.log
    assert {name: len(table) for name, table in tables.items()} == {
        "tracks": len(log.tracks),
        "controls": len(log.controls),
        "events": len(log.events),
    }
    controls, last = tables["controls"], log.controls[-1]
    assert controls["time_s"].tolist() == [record.time_s for record in log.controls]
    assert controls["state"].tolist() == [str(record.state) for record in log.controls]
    assert controls["allowed_yaw_rate_rad_s"][-1] == last.allowed.yaw_rate_rad_s
    assert controls["velocity_down_m_s"][-1] == last.vehicle.position.down_m_s
    assert controls["sent"].dtype == np.bool_
    box = log.tracks[-1].track
    assert tables["tracks"]["cx_px"][-1] == box.box.cx
    assert tables["events"]["text"].tolist() == [event.text for event in log.events]


def test_what_is_not_known_is_nan_or_empty_and_an_empty_log_has_its_columns() -> None:
    log = FlightLog()
    log.add_track(TrackRecord(None, 7, 1.0, 1.1, 1.2, 0.01))
    tables = arrays(log)
    (row,) = tables["tracks"]
    assert (row["sequence"], row["state"]) == (7, "")
    assert math.isnan(row["cx_px"])
    assert len(tables["controls"]) == 0
    assert "asked_forward_m_s" in (tables["controls"].dtype.names or ())


@pytest.mark.slow
def test_pandas_takes_each_table_as_it_is(flight: RecordedFlight) -> None:
    pandas = pytest.importorskip("pandas", reason="no pandas: pip install pandas")
    controls = pandas.DataFrame(flight.arrays()["controls"]).set_index("time_s")
    assert set(controls.groupby("state").size().index) >= {"following"}
    assert controls["allowed_forward_m_s"].dtype == np.float64
