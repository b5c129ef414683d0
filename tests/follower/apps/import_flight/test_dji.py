"""Subtitles of drones: every dialect's position, height, angles and lens; others are refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from follower.recording.telemetry_logs import TelemetryError, read_telemetry

CUES = "1\n00:00:00,000 --> 00:00:01,000\n{0}\n\n2\n00:00:01.000 --> 00:00:60,000\n{1}\n\n"
DIALECTS = {
    "Mavic Pro: longitude first, satellites third": (
        "HOME(131.1660,-25.2088) 2017.07.29 15:18:50\n"
        "GPS({lon},{lat},14) BAROMETER:{height}\nISO:100 Shutter:60 EV: Fnum:2.2 ",
        {},
    ),
    "Mavic Pro's first firmware": (
        "HOME(149.0251,-20.2532) 2017.8.5 14:11:51\nGPS({lon},{lat},16) Hb:{height} Hs:1.9\n"
        "ISO:100 TV:60 EV: 0 IR:F2.8",
        {},
    ),
    "Matrice 300: latitude first where metres are third": (
        "2022.06.21 16:06:17\nGPS({lat},{lon},0.0M) BAROMETER:{height}M",
        {},
    ),
    "Phantom 4 RTK: all on one line": (
        "F/5.6, SS 400, ISO 100, EV 0, GPS ({lon}, {lat}, 15), HOME (-58.8, -34.2, -57.98m), "
        "D 698.70m, H {height}m, H.S 0.00m/s, V.S 0.00m/s, F.PRY (2.7°, -7.0°, 110.1°), "
        "G.PRY (-24.4°, 0.0°, 110.4°)",
        {"attitude": (-7.0, 2.7, 110.1), "gimbal": (0.0, -24.4, 110.4)},
    ),
    "Phantom 4 RTK with corrections": (
        "F/6.3, SS 60, ISO 100, EV 0, RTK ({lon}, {lat}, 28), HOME (-58.8, -34.2, 103.55m), "
        "D 75.36m, H {height}m, H.S 0.30m/s, V.S 0.00m/s, F.PRY (-5.3°, 2.1°, 28.3°), "
        "G.PRY (-40.0°, 0.0°, 28.2°)",
        {"attitude": (2.1, -5.3, 28.3), "gimbal": (0.0, -40.0, 28.2)},
    ),
    "Mavic 2: radians, and longitude misspelt": (
        "[iso : 100] [shutter : 1/80.0] [fnum : 280] [latitude : {lat_rad}] "
        "[longtitude : {lon_rad}] [altitude: {altitude}] ",
        {},
    ),
    "Mini 2: degrees, and longitude misspelt": (
        "[latitude : {lat}] [longtitude : {lon}] [altitude: {altitude}]",
        {},
    ),
    "Air 2S: in a font, focal length in tenths": (
        '<font size="36">SrtCnt : 1, DiffTime : 33ms\n2022-08-07 13:40:40,774,808\n'
        "[iso : 100] [ct : 5744] [color_md : default] [focal_len : 240] [latitude: {lat}] "
        "[longitude: {lon}] [altitude: {altitude}] </font>",
        {"fov_deg": 76.3},
    ),
    "decimal commas": (
        "[latitude: {lat_comma}] [longitude: {lon_comma}] [rel_alt: {height} abs_alt: 118,0]",
        {},
    ),
    "Mini 3: two heights": (
        '<font size="28">FrameCnt: 1, DiffTime: 33ms\n2023-01-02 03:04:05.678\n[iso: 100] '
        "[focal_len: 24.00] [dzoom_ratio: 20000, delta:0],[latitude: {lat}] [longitude: {lon}] "
        "[rel_alt: {height} abs_alt: 132.860] [ct: 5300] </font>",
        {"fov_deg": 42.9},
    ),
    "Mavic 3 Enterprise: gimbal, and so its heading for the aircraft's; zoom as a factor": (
        "[focal_len: 24.00] [dzoom_ratio: 2.00], [latitude: {lat}] [longitude: {lon}] "
        "[rel_alt: {height} abs_alt: 150.5] \n"
        "[gb_yaw : 45.2] [gb_pitch : -15.0] [gb_roll : 0.5]</font>",
        {"attitude": (0.0, 0.0, 45.2), "gimbal": (0.5, -15.0, 45.2), "fov_deg": 42.9},
    ),
    "Matrice 30: an empty line inside": (
        "<font size='28'>FrameCnt: 1, DiffTime: 33ms\n2024-02-27 22:30:45.395\n[fnum: 1.0] "
        "[focal_len: 58.00] [dzoom: 1.00]\n[latitude: {lat}] [longitude: {lon}] "
        "[rel_alt: {height} abs_alt: 97.829] \n[drone_speedx: 0.2 drone_speedy: 0.0 "
        "drone_speedz: 0.0] \n[drone_yaw: -20.4 drone_pitch: 2.4 drone_roll: -2.1] \n"
        "[gb_yaw: -30.0 gb_pitch: -29.9 gb_roll: 0.0] \n\n0\n[dzoom_ratio: 10000, delta:0]\n"
        "</font>",
        {"attitude": (-2.1, 2.4, -20.4), "gimbal": (0.0, -29.9, -30.0), "fov_deg": 36.0},
    ),
    "Autel Evo: directions by name": (
        "HOME(W: 58.8, S: 34.2) 2023-09-12 10:28:07\nGPS(W: {west}, S: {south}, {altitude}m)\n"
        "ISO:100 SHUTTER:1000 EV: 0.0 F-NUM:1.8\n"
        "F.PRY (1.0°, -3.7°, -59.0°), G.PRY (-51.1°, 0.0°, -58.9°)",
        {"attitude": (-3.7, 1.0, -59.0), "gimbal": (0.0, -51.1, -58.9)},
    ),
}
SOUTH_WEST = (-34.237922, -58.851745)


def cue(template: str, latitude: float, longitude: float, height_m: float) -> str:
    return template.format(
        lat=f"{latitude:.6f}",
        lon=f"{longitude:.6f}",
        lat_rad=f"{math.radians(latitude):.8f}",
        lon_rad=f"{math.radians(longitude):.8f}",
        lat_comma=f"{latitude:.6f}".replace(".", ","),
        lon_comma=f"{longitude:.6f}".replace(".", ","),
        west=f"{-longitude:.6f}",
        south=f"{-latitude:.6f}",
        height=f"{height_m:.2f}",
        altitude=f"{1400 + height_m:.2f}",
    )


@pytest.mark.parametrize("name", DIALECTS)
def test_each_dialect_says_the_same(name: str, tmp_path: Path) -> None:
    template, more = DIALECTS[name]
    first = cue(template, *SOUTH_WEST, 0.0)
    later = cue(template, SOUTH_WEST[0] + 1e-4, SOUTH_WEST[1] - 2e-4, 12.5)
    path = tmp_path / "subtitles.txt"  # the name says nothing
    path.write_text(CUES.format(first, later), "utf-8")
    log = read_telemetry(path)
    assert log.on_video_clock
    assert (log.origin.latitude_deg, log.origin.longitude_deg) == pytest.approx(SOUTH_WEST)
    place = log.positions[-1]
    assert (place.time_s, place.down_m) == pytest.approx((1.0, -12.5))
    assert (place.north_m, place.east_m) == pytest.approx((11.12, -18.39), abs=0.15)
    assert (place.north_m_s, place.down_m_s) == pytest.approx((11.12, -12.5), rel=0.02)
    angles = {"attitude": None, "gimbal": None}
    if log.attitudes:
        angles["attitude"] = in_degrees(log.attitudes[0])
        angles["gimbal"] = in_degrees(log.gimbals[0].attitude)
        assert log.gimbals[0].from_north
        assert log.gimbals[0].is_level
    for kind, found in angles.items():
        assert found == (None if kind not in more else pytest.approx(more[kind], abs=1e-6))
    assert log.fov_deg == (
        None if "fov_deg" not in more else pytest.approx(more["fov_deg"], abs=0.3)
    )


def in_degrees(attitude: object) -> tuple[float, ...]:
    return tuple(math.degrees(one) for one in attitude.numbers[:3])  # type: ignore[attr-defined]


def test_a_cue_that_is_cut_off_does_not_move_the_drone(tmp_path: Path) -> None:
    text = CUES.format(*["[latitude: 41.424724] [longitude: 2.234156] [altitude: 117.0]"] * 2)
    path = tmp_path / "cut.SRT"
    path.write_text(text[: text.rindex("24724")])
    assert [place.time_s for place in read_telemetry(path).positions] == [0.0]


def test_no_fix_is_no_place(tmp_path: Path) -> None:
    path = tmp_path / "indoors.SRT"
    path.write_text(CUES.format(*["[latitude: 0.0] [longitude: 0.0] [rel_alt: 1.0]"] * 2))
    with pytest.raises(TelemetryError, match=r"indoors\.SRT: no position"):
        read_telemetry(path)


@pytest.mark.parametrize(
    "content", [b"", b"1\n00:00:00,000 --> 00:00:02,000\n- Hello!\n\n", bytes(range(256)) * 40]
)
def test_other_subtitles_are_refused_in_one_line(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "film.srt"
    path.write_bytes(content)
    with pytest.raises(TelemetryError, match=r"film\.srt: no position of a drone") as error:
        read_telemetry(path)
    assert "\n" not in str(error.value)
