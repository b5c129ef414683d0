"""Identification from files: the recorded steps of real autopilots, and what is refused."""

import csv
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from real_data import DATA, needs_data

from follower.tuning.identify.readers import Recording, VehicleAxis
from follower.tuning.identify.result import Spread, delay_named, load_vehicle, write_identification
from follower.tuning.identify.run import identification, identify, read_recording
from follower_control.common.strict_config import SettingsError
from follower_control.tuning.fit import fit_size
from follower_control.tuning.response_model import ResponseData, ResponseModel, TooLittleError

STEPS = DATA / "autopilot_steps"
needs_steps = needs_data("autopilot_steps")


@needs_steps
@pytest.mark.slow
def test_recorded_steps_of_arducopter_give_its_known_limits(tmp_path: Path) -> None:
    names = ("ap_vx3_f9", "ap_vx8_f9", "ap_yawrate30_f9", "ap_vz_up1_f9", "ap_takeoff10")
    found = identification([read_recording(STEPS / f"{name}.csv") for name in names])
    forward, turning = found.fits[VehicleAxis.FORWARD], found.fits[VehicleAxis.YAW_RATE]
    assert forward.held_out_fit > 0.9
    assert forward.model.gain == pytest.approx(1.0, abs=0.05)
    # WPNAV_ACCEL is 2.5 m/s2 by default.
    assert forward.model.rate_limit == pytest.approx(2.5, abs=0.2)
    assert turning.model.gain == pytest.approx(1.0, abs=0.05)
    assert any("ap_takeoff10" in remark for remark in found.remarks)
    path = tmp_path / "vehicle.yaml"
    path.write_text(found.to_yaml(), "utf-8")
    model = load_vehicle(path).model()
    assert model.forward == model.right
    assert model.yaw_rate.gain == pytest.approx(turning.model.gain, rel=1e-3)
    page = write_identification(tmp_path / "page.html", found, "follower identify …").read_text()
    assert page.count("<svg") == len(found.fits)
    assert "held out" in page


@needs_steps
def test_a_file_without_steps_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="nothing can be identified"):
        identify([STEPS / "px_takeoff10.csv"], tmp_path, True, "follower identify")
    assert not list(tmp_path.iterdir())


def test_what_is_no_recording_is_refused_in_plain_words(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="no such file"):
        read_recording(tmp_path / "missing")
    other = tmp_path / "a.txt"
    other.write_text("x")
    with pytest.raises(SettingsError, match="folders, PX4 logs"):
        read_recording(other)
    table = tmp_path / "a.csv"
    table.write_text("time,value\n1,2\n")
    with pytest.raises(
        SettingsError, match=r"column 't_boot' is missing; needed are t_boot, vx, .*sp_yawrate"
    ):
        read_recording(table)
    table.write_text("")
    with pytest.raises(SettingsError, match="recorded steps"):
        read_recording(table)


@needs_steps
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda rows: rows[:60] + rows[131:], r"1\.4\d s are missing before row 62: cut"),
        (lambda rows: rows[:9] + [("", *row[1:]) for row in rows[9:12]] + rows[12:], "in row 11"),
        (lambda rows: [(str(1e3 * float(a)), *b) for a, *b in rows], "t_boot is in seconds"),
        (lambda rows: [(str(1e6 * float(a)), *b) for a, *b in rows], "t_boot is in seconds"),
        (lambda rows: rows[:1], "one row alone"),
        (lambda rows: rows[:0], "no rows under the heading"),
    ],
)
def test_times_that_would_make_the_fit_wrong_are_refused(
    tmp_path: Path, change: Callable[[list[Any]], list[Any]], says: str
) -> None:
    with (STEPS / "px_vx8_f8.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head[0] == "t_boot"
    path = tmp_path / "steps.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([head, *change(rows)])
    with pytest.raises(SettingsError, match=says):
        read_recording(path)


def test_a_row_with_more_values_than_columns_is_refused(tmp_path: Path) -> None:
    """As with decimal commas, which put every value behind them into the wrong column."""
    path = tmp_path / "steps.csv"
    path.write_text("t_boot,vx\n0.1,2\n0,2,3,5\n")
    with pytest.raises(SettingsError, match="row 3 has more values"):
        read_recording(path)


@needs_steps
def test_a_table_that_a_spreadsheet_saved_is_read(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    path.write_bytes(b"\xef\xbb\xbf" + (STEPS / "px_vx8_f8.csv").read_bytes())
    assert read_recording(path).axes


def write_ulog(path: Path, answer: ResponseModel) -> Path:
    """Write PX4's format: steps north and in yaw while the nose looks east, at 50 Hz."""
    formats = {
        "vehicle_attitude": "uint64_t timestamp;float[4] q;",
        "vehicle_angular_velocity": "uint64_t timestamp;float[3] xyz;",
        "vehicle_local_position": "uint64_t timestamp;"
        + "".join(f"float {name};" for name in ("x", "y", "z", "vx", "vy", "vz")),
        "trajectory_setpoint": "uint64_t timestamp;float[3] velocity;float yawspeed;",
    }
    times = np.arange(0.0, 24.0, 0.02)
    steps = np.array([0.0, 2.0, 6.0, 10.0, 14.0, 18.0])
    levels = np.array([0.0, 1.0, -1.0, 0.0, 2.0, 0.0])
    flown = ResponseData("", steps, levels, times, 0 * times).predicted(answer)
    asked = levels[np.searchsorted(steps, times, "right") - 1]
    out = [b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 0), _part("B", bytes(40))]
    out += [_part("F", f"{name}:{fields}".encode()) for name, fields in formats.items()]
    out += [_part("A", struct.pack("<BH", 0, n) + k.encode()) for n, k in enumerate(formats)]
    east = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    for t, speed, wanted in zip(times.tolist(), flown.tolist(), asked.tolist(), strict=True):
        rows = (east, (0, 0, 0.3 * speed), (0, 0, -9, speed, 0, 0), (wanted, 0, 0, 0.3 * wanted))
        for number, row in enumerate(rows):
            stamp = round(1e6 * (t + 1.0))
            out.append(_part("D", struct.pack(f"<HQ{len(row)}f", number, stamp, *row)))
    path.write_bytes(b"".join(out))
    return path


def _part(kind: str, data: bytes) -> bytes:
    return struct.pack("<HB", len(data), ord(kind)) + data


def test_a_px4_log_gives_the_axes_in_the_vehicles_own_frame(tmp_path: Path) -> None:
    truth = ResponseModel(0.9, 0.2, 0.4)
    found = identification([read_recording(write_ulog(tmp_path / "log.ulg", truth))])
    assert set(found.fits) == {VehicleAxis.RIGHT, VehicleAxis.YAW_RATE}
    for fit in found.fits.values():
        assert fit.model.gain == pytest.approx(0.9, abs=0.02)
        assert fit.model.dead_time_s == pytest.approx(0.2, abs=0.04)
        assert fit.held_out_fit > 0.95
    other = tmp_path / "other.ulg"
    other.write_text("no")
    with pytest.raises(ValueError, match="no PX4 log"):
        read_recording(other)


def test_the_next_step_is_one_that_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the vehicle's axes this log moved two."""
    log = write_ulog(tmp_path / "log.ulg", ResponseModel(0.9, 0.2, 0.4))
    identify([log], tmp_path / "runs", False, "follower identify")
    said = " ".join(capsys.readouterr().out.split())
    assert "Next: follower tune" not in said
    assert "not known for forward, down: identify a flight of `follower excite`" in said
    assert "[m/s]" in said
    assert "[rad/s]" in said


@pytest.mark.parametrize("is_excitation", [True, False])
def test_a_model_of_a_pursuit_is_told_as_one(is_excitation: bool) -> None:
    times = np.arange(0.0, 24.0, 0.02)
    steps, levels = np.array([0.0, 2.0, 8.0, 14.0]), np.array([0.0, 1.0, -1.0, 0.0])
    asked = ResponseData("fly", steps, levels, times, 0 * times)
    flown = replace(asked, outputs=asked.predicted(ResponseModel(0.9, 0.2, 0.4)))
    axes = {VehicleAxis.FORWARD: [flown]}
    found = identification([Recording("fly", axes, is_excitation=is_excitation)])
    told = any("forward: fitted to pursuits" in remark for remark in found.remarks)
    assert told is not is_excitation


def test_a_delay_is_named_by_its_key_and_in_words() -> None:
    said = {name: delay_named(name) for name in ("camera_s", "frame_interval_s", "position_s")}
    assert said["camera_s"] == (
        "camera_s, from a frame's exposure to the first setpoint made from it"
    )
    assert all(words != f"{name}, " for name, words in said.items())


def test_a_size_comes_back_and_its_slope_where_the_distance_varied() -> None:
    rng = np.random.default_rng(3)
    ranges = np.linspace(8.0, 25.0, 60)
    angles = 1.7 / ranges * np.exp(rng.normal(0.0, 0.05, 60))
    found = fit_size(angles.tolist(), ranges.tolist())
    assert found.size_m.low <= 1.7 <= found.size_m.high
    assert found.slope.low <= 1.0 <= found.slope.high
    assert found.spread == pytest.approx(0.05, rel=0.5)
    steady = fit_size((1.7 / np.full(60, 12.0)).tolist(), [12.0] * 60)
    assert steady.slope is None
    with pytest.raises(TooLittleError, match="only 3 observations"):
        fit_size([0.1] * 3, [10.0] * 3)
    with pytest.raises(TooLittleError, match="finite"):
        fit_size([math.nan] * 20, [10.0] * 20)


def test_the_median_of_delays_has_an_interval_that_holds_it() -> None:
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(100):
        spread = Spread.of(rng.exponential(0.1, 200).tolist())
        inside += spread.median.low <= 0.1 * math.log(2) <= spread.median.high
    assert inside >= 88
    assert Spread.of([0.1] * 3) is None
    assert Spread.of([math.inf] * 50) is None


def test_a_vehicle_file_says_what_is_wrong_with_it(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.yaml"
    axis = {"gain": 1.0, "dead_time_s": 0.2, "time_constant_s": 0.3}
    path.write_text(yaml.safe_dump({"vehicle": {"forward": axis}}))
    with pytest.raises(SettingsError, match="not known for right, down, yaw_rate"):
        load_vehicle(path).model()
    path.write_text(yaml.safe_dump({"vehicle": {"forward": {**axis, "gian": 1.0}}}))
    with pytest.raises(SettingsError, match="gian"):
        load_vehicle(path)
