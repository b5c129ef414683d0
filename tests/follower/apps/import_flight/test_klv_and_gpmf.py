"""MISB ST 0601 and GPMF: values as the standards give them; any bytes are an error or values."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from foreign_recordings import (
    LATITUDE,
    LONGITUDE,
    gopro_payload,
    gpmf,
    gpmf_stream,
    klv_packet,
    write_video,
    yaw_rad,
    yaw_rate_rad_s,
)
from hypothesis import given
from hypothesis import strategies as st

from follower.recording.telemetry_logs import TelemetryError, read_telemetry
from follower.recording.telemetry_logs.gpmf import GpmfReader
from follower.recording.telemetry_logs.gpmf import decode as decode_gpmf
from follower.recording.telemetry_logs.klv import KlvReader, decode, split
from follower_vision.sources.video_file import VideoFile

VALUES = {
    5: 159.97, 6: -0.43, 7: 3.41, 13: 60.1768, 14: 128.4268, 15: 14190.7, 16: 1.44,
    18: 160.72, 19: -168.79, 20: 0.0, 25: 3216.0,
}  # fmt: skip
PACKET = klv_packet(1_231_798_102_000_000, VALUES)


def test_a_packet_s_values_are_degrees_and_metres() -> None:
    values = decode(PACKET)
    assert values == pytest.approx({2: 1_231_798_102.0, **VALUES}, abs=0.2)
    assert values[14] == pytest.approx(VALUES[14], abs=1e-6)


def test_the_standard_s_own_numbers_are_understood() -> None:
    """Examples of MISB ST 0601: 0x71C2 is a heading, 0x5595B66D a latitude, 0x8000 unknown."""
    packet = klv_packet(0, {5: 0.0, 13: 0.0, 6: 0.0})
    for old, new in ((b"\x05\x02\0\0", b"\x05\x02\x71\xc2"), (b"\x06\x02\0\0", b"\x06\x02\x80\0")):
        packet = packet.replace(old, new)
    packet = packet.replace(b"\x0d\x04\0\0\0\0", b"\x0d\x04\x55\x95\xb6\x6d")
    total = sum(byte << (8 if n % 2 == 0 else 0) for n, byte in enumerate(packet[:-2]))
    values = decode(packet[:-2] + (total & 0xFFFF).to_bytes(2))
    assert values[5] == pytest.approx(159.974, abs=1e-3)
    assert values[13] == pytest.approx(60.17682297, abs=1e-6)
    assert 6 not in values


@pytest.mark.parametrize("at", [20, 40, len(PACKET) - 1])
def test_a_wrong_byte_is_noticed_by_the_checksum(at: int) -> None:
    broken = PACKET[:at] + bytes([PACKET[at] ^ 0x10]) + PACKET[at + 1 :]
    with pytest.raises(TelemetryError, match="checksum"):
        decode(broken)


def test_packets_are_cut_out_of_any_pieces_and_broken_ones_left_out() -> None:
    stream = b"noise" + PACKET + PACKET[:50] + PACKET + b"\xff" * 7 + PACKET
    found, rest = [], b""
    for at in range(0, len(stream), 11):
        packets, rest = split(rest + stream[at : at + 11])
        found += packets
    assert found == [PACKET, PACKET[:50], PACKET, PACKET]
    reader = KlvReader()
    reader.take(stream, 0.0, 0.0)
    assert reader.broken == 1
    assert len(reader.samples().attitudes) == 3


def test_packets_from_before_the_aircraft_s_clock_was_set_have_the_video_s_times() -> None:
    reader = KlvReader()
    for n in range(10):
        since_1970_us = 0 if n < 3 else 1_231_798_102_000_000
        reader.take(klv_packet(since_1970_us + 100_000 * n, VALUES), n / 10, 0.1)
    log = reader.samples().log("test")
    assert [one.time_s for one in log.attitudes] == pytest.approx([n / 10 for n in range(10)])


@given(st.binary(max_size=400), st.integers(0, 200))
def test_any_bytes_are_packets_or_a_clear_error(noise: bytes, at: int) -> None:
    for data in (noise, PACKET[:at] + noise, PACKET[:16] + noise, PACKET + noise + PACKET[:at]):
        reader = KlvReader()
        reader.take(data, 1.0, 0.04)
        reader.take(PACKET[at:], math.nan, 0.04)
        try:
            decode(data)
            reader.samples().log("noise")
        except TelemetryError:
            pass


PAYLOAD = gopro_payload(0.0, 0.0, 100)


@pytest.mark.parametrize("orientation", ["ZXY", "YxZ", "XzY"])
def test_gpmf_is_scaled_and_turned_to_the_body_s_axes(orientation: str) -> None:
    reader = GpmfReader()
    for second in range(3):
        payload = gopro_payload(second, 0.0, 100 * (second + 1), orientation)
        reader.take(payload, second + 0.5, 1.0)
    samples = reader.samples()
    time_s, *rates = samples.gyro[150]
    assert time_s == pytest.approx(2.0, abs=1e-6)  # the first payload's time, then STMP and TSMP
    assert rates == pytest.approx((0.0, 0.0, yaw_rate_rad_s(1.5)), abs=2e-3)
    log = samples.log("test")
    assert (log.origin.latitude_deg, log.origin.longitude_deg) == (LATITUDE, LONGITUDE)
    assert log.positions[15].north_m_s == pytest.approx(4.0, abs=0.1)
    attitude = log.attitudes[200]
    assert (attitude.roll_rad, attitude.pitch_rad) == pytest.approx((0.0, 0.0), abs=1e-3)
    turned = attitude.yaw_rad - log.attitudes[0].yaw_rad
    assert turned == pytest.approx(yaw_rad(2.0) - yaw_rad(0.0), abs=0.01)
    mean = np.mean([yaw_rad(n / 100) for n in range(300)])
    assert attitude.yaw_rad == pytest.approx(yaw_rad(2.0) - mean, abs=0.02)


def test_a_gps_that_has_no_fix_at_first_tells_the_same_times_as_the_gyro() -> None:
    reader = GpmfReader()
    for second in range(4):
        mark = gpmf("STMP", "J", 8, struct.pack(">Q", 1_000_000 * second + 250_000))
        fix = gpmf("GPSF", "L", 4, struct.pack(">L", 3 if second >= 2 else 0))
        place = [[LATITUDE, LONGITUDE, 520.0, 4.0, 4.0]] * 10
        streams = gpmf_stream("GYRO", "s", [[0.0] * 3] * 10, [939] * 3, mark)
        streams += gpmf_stream("ACCL", "s", [[9.8, 0.0, 0.0]] * 10, [417] * 3, mark)
        streams += gpmf_stream("GPS5", "l", place, [10**7, 10**7, 1000, 1000, 100], mark, fix)
        reader.take(gpmf("DEVC", "", 1, streams), second + 0.5, 1.0)
    samples = reader.samples()
    assert samples.places[0][0] == pytest.approx(2.5)
    assert samples.places[-1][0] == pytest.approx(samples.gyro[-1][0])


def test_gps9_gives_places_and_its_own_fix() -> None:
    row = (LATITUDE, LONGITUDE, 500.0, 3.0, 3.0, 8000, 45_000.5, 1.2)
    scales = [10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1]
    data = b"".join(
        struct.pack(">7l2H", *(round(v * s) for v, s in zip(row, scales, strict=False)), fix)
        for fix in (0, 3, 3)
    )
    stream = (
        gpmf("TYPE", "c", 1, b"lllllllSS")
        + gpmf("SCAL", "l", 4, struct.pack(">9l", *scales))
        + gpmf("GPS9", "?", 32, data)
    )
    payload = gpmf("DEVC", "", 1, gpmf("STRM", "", 1, stream))
    reader = GpmfReader()
    reader.take(payload, 0.0, 0.3)
    log = reader.samples().log("test")
    assert [one.time_s for one in log.positions] == pytest.approx([0.1, 0.2])
    assert log.origin.latitude_deg == pytest.approx(LATITUDE, abs=1e-7)


@pytest.mark.parametrize("at", [6, 100, len(PAYLOAD) - 8])
def test_a_payload_that_is_cut_off_is_an_error(at: int) -> None:
    with pytest.raises(TelemetryError, match="cut off"):
        decode_gpmf(PAYLOAD[: at + 3])
    reader = GpmfReader()
    reader.take(PAYLOAD[:at], 0.0, 1.0)
    with pytest.raises(TelemetryError, match="nothing to import"):
        reader.samples()


@given(st.binary(max_size=300), st.integers(0, len(PAYLOAD)))
def test_any_bytes_are_gpmf_or_a_clear_error(noise: bytes, at: int) -> None:
    for data in (noise, PAYLOAD[:at] + noise, PAYLOAD[:at] + noise + PAYLOAD[at + len(noise) :]):
        reader = GpmfReader()
        reader.take(data, 0.0, 1.0)
        reader.take(PAYLOAD, 1.0, 1.0)
        try:
            decode_gpmf(data)
            reader.samples().log("noise")
        except TelemetryError:
            pass


@given(
    st.sampled_from([b"GYRO", b"ACCL", b"GPS5", b"GPS9"]),
    st.sampled_from("bBsSlLfdjJcF?"),
    st.integers(1, 40),
    st.binary(max_size=120),
    st.binary(max_size=12),
)
def test_a_stream_of_any_type_is_values_or_a_clear_error(
    key: bytes, kind: str, size: int, data: bytes, layout: bytes
) -> None:
    stream = (
        gpmf("TYPE", "c", 1, layout)
        + gpmf("SCAL", kind if kind != "?" else "s", 2, data[:8])
        + gpmf(key.decode(), kind, size, data[: len(data) // size * size])
    )
    reader = GpmfReader()
    reader.take(gpmf("DEVC", "", 1, gpmf("STRM", "", 1, stream)), 0.0, 1.0)
    reader.take(PAYLOAD, 1.0, 1.0)
    assert reader.samples().log("noise").positions


def test_both_are_read_out_of_real_containers_from_the_video_s_first_frame(tmp_path: Path) -> None:
    packets = [(n / 20, 0.05, klv_packet(10**15 + n * 50_000, VALUES)) for n in range(40)]
    flight = read_telemetry(write_video(tmp_path / "fmv.ts", 2.0, "klv", packets))
    assert [one.time_s for one in flight.attitudes[:3]] == pytest.approx([0.0, 0.05, 0.1])
    assert math.degrees(flight.attitudes[0].yaw_rad) == pytest.approx(VALUES[5], abs=0.01)
    assert flight.positions[0].down_m == pytest.approx(VALUES[25] - VALUES[15], abs=0.4)
    payloads = [(float(n), 1.0, gopro_payload(n, 0.0, 100 * (n + 1))) for n in range(2)]
    walk = read_telemetry(write_video(tmp_path / "GX010001.MP4", 2.0, "bin_data", payloads))
    assert walk.attitudes[0].time_s == pytest.approx(0.0, abs=1e-3)
    assert walk.positions[-1].time_s == pytest.approx(1.9, abs=1e-3)


def test_times_count_from_the_first_frame_that_can_be_shown(tmp_path: Path) -> None:
    """A stream's dump begins underway: nothing can be shown before the next key frame."""
    packets = [
        (n / 20, 0.05, klv_packet(10**15 + n * 50_000, {**VALUES, 5: float(n)})) for n in range(60)
    ]
    coding = {"codec": "libx264", "g": "30", "bf": "0", "sc_threshold": "0"}
    path = write_video(tmp_path / "fmv.ts", 3.0, "klv", packets, **coding)
    whole = path.read_bytes()
    path.write_bytes(whole[len(whole) // 6 // 188 * 188 :])
    with VideoFile(path) as video:
        assert len(list(iter(video.read, None))) == 30
    times_s = {
        round(math.degrees(one.yaw_rad)): one.time_s for one in read_telemetry(path).attitudes
    }
    assert times_s[30] == pytest.approx(0.0, abs=1e-3)


def test_a_stream_of_klv_that_is_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    packets = [(n / 20, 0.05, klv_packet(10**15 + n * 50_000, VALUES)) for n in range(40)]
    path = write_video(tmp_path / "fmv.ts", 2.0, "klv", packets)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert 0.3 < read_telemetry(path).end_s < 1.7


def test_a_video_without_either_says_so(tmp_path: Path) -> None:
    path = write_video(tmp_path / "clip.mp4", 0.5)
    with pytest.raises(TelemetryError, match=r"clip\.mp4: unknown kind"):
        read_telemetry(path)


def test_gpmf_streams_are_written_as_they_are_read() -> None:
    rows = [[1.0, -2.0, 3.0], [0.5, 0.25, -0.125]]
    payload = gpmf("DEVC", "", 1, gpmf_stream("GYRO", "s", rows, [1000] * 3))
    assert decode_gpmf(payload)[b"GYRO"].values == pytest.approx(np.array(rows))
