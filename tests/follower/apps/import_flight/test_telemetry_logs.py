"""All kinds of telemetry logs say the same about the same flight; broken ones say what is wrong."""

from __future__ import annotations

import gc
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.recording.telemetry_logs import (
    TelemetryError,
    TelemetryLog,
    TelemetryPlayback,
    read_telemetry,
)
from follower.recording.telemetry_logs.samples import TelemetrySamples, body_rates

KINDS = ("csv", "tlog", "bin", "ulg")
BEGINS_S = 3.0
"""Of the script's clock, the log's first attitude is this much before 0."""


@pytest.fixture(scope="module")
def logs(
    writers: Any, script: Any, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, TelemetryLog]:
    folder = tmp_path_factory.mktemp("logs")
    return {kind: read_telemetry(writers[kind](folder / f"f.{kind}", script)) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_attitudes_rates_and_places_are_the_flight_s(
    kind: str, logs: dict[str, TelemetryLog], script: Any
) -> None:
    log = logs[kind]
    assert log.start_s == 0.0
    assert len(log.attitudes) / log.end_s == pytest.approx(50.0, rel=0.02)
    for attitude in log.attitudes[::37]:
        t = attitude.time_s - BEGINS_S
        angles = (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
        # A tlog's times are whole milliseconds, a .bin's angles whole hundredths of a degree.
        assert angles == pytest.approx(script.angles(t), abs=2e-3)
        rates = (attitude.roll_rate_rad_s, attitude.pitch_rate_rad_s, attitude.yaw_rate_rad_s)
        assert rates == pytest.approx(script.rates(t), abs=5e-3)
    for place in log.positions[::17]:
        t = place.time_s - BEGINS_S
        assert (place.north_m, place.east_m, place.down_m) == pytest.approx(
            script.position(t), abs=0.01
        )
        assert (place.north_m_s, place.east_m_s, place.down_m_s) == pytest.approx(
            script.velocity(t), abs=0.01
        )


def test_modes_are_read(logs: dict[str, TelemetryLog]) -> None:
    found = {kind: [(one.mode, one.armed) for one in log.modes] for kind, log in logs.items()}
    assert found == {
        "csv": [("LOITER", True)],
        "tlog": [("OFFBOARD", True)],
        "bin": [("GUIDED", True)],
        "ulg": [("OFFBOARD", True)],
    }


def test_rates_follow_from_angles_where_there_is_no_gyro(script: Any) -> None:
    time_s = np.arange(0, 10, 0.02)
    rows = np.array([(t, *script.angles(t)) for t in time_s])
    wanted = np.array([script.rates(t) for t in time_s])
    assert body_rates(rows)[1:-1] == pytest.approx(wanted[1:-1], abs=2e-3)


def test_samples_that_are_not_finite_or_not_newer_are_left_out() -> None:
    rows: list[tuple[float, ...]] = [
        (0.0, 0.0, 0.0, 0.0),
        (0.1, math.nan, 0.0, 0.0),
        (0.2, 0.1, 0.0, 0.0),
        (0.15, 9.0, 9.0, 9.0),
        (0.2, 9.0, 9.0, 9.0),
        (0.3, 0.2, 0.0, 0.0),
    ]
    log = TelemetrySamples(attitudes=rows).log("test")
    assert [one.time_s for one in log.attitudes] == [0.0, 0.2, 0.3]
    assert log.attitudes[1].roll_rate_rad_s == pytest.approx(2 / 3, abs=0.2)


def test_a_mode_without_a_time_does_not_hold_back_those_behind_it(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = "0,0,0,0,HOLD", ",0,0,0,OFFBOARD", "1,0,0,0,OFFBOARD", "2,0,0,0,HOLD"
    path.write_text("\n".join(("time_s,roll_deg,pitch_deg,yaw_deg,mode", *rows)))
    playback = TelemetryPlayback(read_telemetry(path), 0.0)
    assert [playback.until(t)[0].mode for t in (0, 1, 2)] == ["HOLD", "OFFBOARD", "HOLD"]


def test_places_of_which_none_is_finite_are_no_telemetry() -> None:
    samples = TelemetrySamples(places=[(0.0, math.nan, 0.0, 0.0)])
    with pytest.raises(TelemetryError, match="there is no attitude"):
        samples.log("test")


def test_a_camera_that_looks_straight_down_rolls_when_the_drone_yaws() -> None:
    time_s = np.arange(0, 4, 0.05)
    yaw = 3.0 + 0.4 * np.sin(time_s)  # passes south, where angles jump
    down = np.full_like(time_s, -math.pi / 2)
    samples = TelemetrySamples(gimbal_from_north=True)
    samples.attitudes = [(t, 0.0, 0.0, y) for t, y in zip(time_s, yaw, strict=True)]
    turned = np.arctan2(np.sin(yaw), np.cos(yaw))
    samples.gimbals = [(t, 0.0, p, y) for t, p, y in zip(time_s, down, turned, strict=True)]
    held = samples.log("test").of_camera().rates
    assert held.rates_rad_s[:, 0] == pytest.approx(0.4 * np.cos(held.middle_s), abs=1e-3)
    assert held.rates_rad_s[:, 1:] == pytest.approx(0.0, abs=1e-6)


def test_places_on_earth_become_metres_and_back_also_across_the_date_line() -> None:
    samples = TelemetrySamples()
    samples.add_fix(0.0, -17.0, 179.9999, 5.0)
    samples.add_fix(1.0, -16.9999, -179.9999, 7.0)
    samples.add_fix(2.0, 91.0, 0.0, 7.0)  # nowhere
    log = samples.log("test")
    place = log.positions[-1]
    assert (place.time_s, place.down_m) == (1.0, -7.0)
    assert (place.north_m, place.east_m) == pytest.approx((11.12, 21.27), abs=0.01)
    latitude, longitude = log.origin.geolocated(place.north_m, place.east_m)
    assert (latitude, longitude) == pytest.approx((-16.9999, -179.9999))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("content", [b"", b"hello, I am something else\n", bytes(500)])
def test_a_foreign_file_is_refused_in_one_line(kind: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"log.{kind}"
    path.write_bytes(content)
    with pytest.raises(TelemetryError, match=rf"log\.{kind}"):
        read_telemetry(path)


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_that_is_cut_off_is_read_up_to_there(
    kind: str, writers: Any, script: Any, tmp_path: Path
) -> None:
    path = writers[kind](tmp_path / f"log.{kind}", script)
    data = path.read_bytes()
    cut = data[: len(data) // 2]
    # A table ends with a whole line; in the others the cut goes through a message.
    path.write_bytes(cut[: cut.rfind(b"\n") + 1] if kind == "csv" else cut)
    log = read_telemetry(path)
    assert 5 < log.end_s < 15


@pytest.mark.parametrize(
    ("kind", "old", "new", "says"),
    [
        ("ulg", b"float[4] q;", b"float[4] Q;", r"lacks the field 'q\[0\]'"),
        ("bin", b"Yaw", b"Jaw", "lacks Yaw"),
        ("bin", b"QBfff\0", b"QBnff\0", "cannot be read: could not convert string to float"),
        ("bin", b"Qccccc\0", b"Qcncc\0\0", "cannot be read"),
    ],
)
def test_a_field_that_another_version_calls_otherwise_is_named(
    kind: str, old: bytes, new: bytes, says: str, writers: Any, script: Any, tmp_path: Path
) -> None:
    path = writers[kind](tmp_path / f"log.{kind}", script)
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new))
    with pytest.raises(TelemetryError, match=says) as error:
        read_telemetry(path)
    assert "is not known here" in str(error.value)


@pytest.mark.slow
def test_a_damaged_dataflash_log_is_told_in_one_line(
    writers: Any, script: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = writers["bin"](tmp_path / "log.bin", script)
    whole = path.read_bytes()
    path.write_bytes(whole + bytes(500))
    assert read_telemetry(path).problem is None, "a card is written in blocks"
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + bytes(600) + whole[middle:])
    log = read_telemetry(path)
    assert log.problem == f"damaged: 600 of its {len(whole) + 600} bytes are no messages"
    assert "".join(capfd.readouterr()) == "", "pymavlink has a line for each byte"


@pytest.mark.timeout(20)
def test_a_ulog_that_leads_its_reader_in_circles_is_refused(tmp_path: Path) -> None:
    """Its last message is of no kind, and shorter by 10 whole ones than it says."""
    kind = b"place:uint64_t timestamp;"
    whole = struct.pack("<HB", len(kind), ord("F")) + kind
    last = struct.pack("<HB", 1 + 10 * len(whole), 0)
    path = tmp_path / "log.ulg"
    path.write_bytes(b"ULog\x01\x12\x35".ljust(16, b"\0") + 40 * whole + last)
    with pytest.raises(TelemetryError, match="cut off or damaged before its first sample"):
        read_telemetry(path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_format_that_pymavlink_does_not_know_is_named(
    writers: Any, script: Any, tmp_path: Path
) -> None:
    """Pymavlink leaves the file to the garbage collector then."""
    path = writers["bin"](tmp_path / "log.bin", script)
    data = path.read_bytes()
    at = data.index(b"ATT\0") + 4
    path.write_bytes(data[:at] + b"$" + data[at + 1 :])
    with pytest.raises(TelemetryError, match="newer than known here"):
        read_telemetry(path)
    gc.collect()


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("log.csv", "time_s,roll_deg,pitch_deg\n0,0,0\n", "yaw_deg is missing"),
        (
            "log.csv",
            "time_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,0\n1,0,north,0\n",
            "line 3: pitch_deg is no number, but 'north'",
        ),
        (
            "log.csv",
            f"time_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,{4096 * 'x'}\n",
            f"line 2: yaw_deg is no number, but '{40 * 'x'}'",
        ),
        (
            "log.csv",
            "time_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,0\n1e14,0,0,0\n2,0,0,0\n",
            r"log\.csv: its times go from 0 s to 1e\+14 s",
        ),
        (
            "log.csv",
            "time_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,0\n1,0,0,0\n90000,0,0,0\n90001,0,0,0\n",
            "from 0 s to 90001 s, more than a day: .* or of another flight",
        ),
        ("log.txt", None, "unknown kind"),
        ("log.tlog", None, "no such file"),
    ],
)
def test_what_cannot_be_read_is_named(
    tmp_path: Path, name: str, text: str | None, said: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(TelemetryError, match=said):
        read_telemetry(tmp_path / name)


def test_other_systems_in_a_tlog_are_not_mistaken_for_the_vehicle(
    writers: Any, script: Any, tmp_path: Path
) -> None:
    path = writers["tlog"](tmp_path / "log.tlog", script)
    ground = mavlink.MAVLink(None, 255, 190)
    beat = mavlink.MAVLink_heartbeat_message(6, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    wrong = mavlink.MAVLink_attitude_message(1, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0)
    head = b"".join(
        struct.pack(">Q", 1_789_999_999_000_000) + message.pack(ground) for message in (beat, wrong)
    )
    path.write_bytes(head + path.read_bytes())
    assert max(abs(one.roll_rad) for one in read_telemetry(path).attitudes) < 1


@pytest.mark.parametrize("said", [mavlink.MAV_AUTOPILOT_INVALID, mavlink.MAV_AUTOPILOT_GENERIC])
@pytest.mark.parametrize("component", [1, 200])  # Betaflight's autopilot is component 200
def test_other_components_of_the_vehicle_in_a_tlog_are_not_mistaken_for_its_autopilot(
    writers: Any, script: Any, tmp_path: Path, component: int, said: int
) -> None:
    path = writers["tlog"](tmp_path / "log.tlog", script, component=component)
    companion = mavlink.MAVLink(None, 1, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
    beat = mavlink.MAVLink_heartbeat_message(18, said, 0, 0, 4, 3)
    wrong = mavlink.MAVLink_attitude_message(99_000, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0)
    first, last = (
        b"".join(struct.pack(">Q", stamp) + message.pack(companion) for message in (beat, wrong))
        for stamp in (1_789_999_999_000_000, 1_790_000_017_000_000)
    )
    path.write_bytes(first + path.read_bytes() + last)
    log = read_telemetry(path)
    assert [one.mode for one in log.modes] == ["OFFBOARD"]
    assert max(abs(one.roll_rad) for one in log.attitudes) < 1


def test_playback_hands_out_each_attitude_once_and_never_early(
    logs: dict[str, TelemetryLog],
) -> None:
    log = logs["csv"].moved(-BEGINS_S)
    playback = TelemetryPlayback(log, 0.0)
    handed = []
    for step in range(300):
        now_s = step * 0.02
        state, attitudes = playback.until(now_s)
        handed += [one.time_s for one in attitudes]
        assert state.obeys_setpoints
        assert state.attitude is not None
        assert state.position is not None
        assert 0 <= state.attitude_age_s(now_s) < 0.021
        assert state.position_age_s(now_s) >= 0
        assert state.mode == "LOITER"
    wanted = [one.time_s for one in log.attitudes if -1.0 <= one.time_s <= 299 * 0.02]
    assert handed == wanted
