"""Live video: what viewers get who speak RTP and RTSP as everybody does."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from video_pictures import HEIGHT, SETTINGS, WIDTH, image, picture, units

from follower.settings.ui import VideoSettings
from follower.ui.video.channel import Picture, VideoChannel
from follower.ui.video.h264_encoder import (
    AccessUnit,
    EncoderError,
    H264Encoder,
    fitted,
    make_encoder,
)
from follower.ui.video.rtp import RtpPacketiser, nal_units, session_description
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import Track, TrackState

# The encoder.


def test_each_picture_comes_out_at_once_and_can_be_decoded() -> None:
    made = units(31)
    assert len(made) == 31
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    frames = [frame for unit in made for frame in decoder.decode(av.Packet(unit.data))]
    frames += decoder.decode(None)
    assert len(frames) == 31
    for number, frame in enumerate(frames):
        error = frame.to_ndarray(format="bgr24").astype(int) - image(number)
        assert np.abs(error).mean() < 6


def test_key_pictures_come_in_time_with_their_parameter_sets() -> None:
    made = units(46)
    keys = [number for number, unit in enumerate(made) if unit.is_key]
    assert keys == [0, 15, 30, 45]
    for number in keys:
        kinds = [nal[0] & 0x1F for nal in nal_units(made[number].data)]
        assert {7, 8, 5} <= set(kinds)
    assert [unit.ticks for unit in made[:3]] == [0, 3000, 6000]


def test_a_clock_that_goes_back_makes_no_time_twice() -> None:
    encoder = H264Encoder("libx264", SETTINGS, WIDTH, HEIGHT)
    ticks = [encoder.encode(image(0), time_s).ticks for time_s in (5.0, 4.0, 5.0)]  # type: ignore[union-attr]
    assert ticks == sorted(set(ticks))


def test_a_replay_of_an_earlier_flight_has_key_pictures_too() -> None:
    encoder = H264Encoder("libx264", SETTINGS, WIDTH, HEIGHT)
    made = [encoder.encode(image(0), time_s) for time_s in (100.0, 1.0, 1.1)]
    assert [unit.is_key for unit in made if unit] == [True, True, False]


def test_the_first_encoder_that_works_is_taken() -> None:
    assert make_encoder(VideoSettings(), 64, 64).name in ("h264_nvenc", "h264_v4l2m2m", "libx264")
    if Path("/dev/video11").exists():
        pytest.skip("this computer has the encoder that is to be missing")
    with pytest.raises(EncoderError, match="h264_v4l2m2m"):
        make_encoder(VideoSettings(encoder="h264_v4l2m2m"), 64, 64)


@given(st.integers(2, 700), st.integers(2, 500), st.integers(64, 800))
def test_pictures_are_fitted_to_even_sizes(width: int, height: int, most: int) -> None:
    small = fitted(np.zeros((height, width, 3), np.uint8), most)
    assert small.shape[0] % 2 == small.shape[1] % 2 == 0
    assert small.shape[1] <= most
    scale = small.shape[1] / width
    assert abs(small.shape[0] - max(2, scale * height)) <= 2 + 2 * height / width


# RTP.


def depacketised(packets: list[bytes]) -> bytes:
    """Return what an RFC 6184 receiver makes of packets."""
    stream = b""
    for packet in packets:
        payload = packet[12:]
        if payload[0] & 0x1F != 28:
            stream += b"\0\0\0\1" + payload
        elif payload[1] & 0x80:
            stream += b"\0\0\0\1" + bytes([(payload[0] & 0xE0) | (payload[1] & 0x1F)]) + payload[2:]
        else:
            stream += payload[2:]
    return stream


@given(
    st.lists(st.binary(min_size=1, max_size=4000), min_size=1, max_size=4), st.integers(0, 1 << 40)
)
def test_packets_hold_what_was_packed(bodies: list[bytes], ticks: int) -> None:
    nals = [b"\x65" + body.replace(b"\0", b"\1") for body in bodies]
    data = b"".join(b"\0\0\0\1" + nal for nal in nals)
    assert nal_units(data) == nals
    packets = RtpPacketiser(7, 0xFFFF).pack(AccessUnit(data, ticks, True))
    assert depacketised(packets) == data
    heads = [struct.unpack("!BBHII", packet[:12]) for packet in packets]
    assert [head[2] for head in heads] == [(0xFFFF + n) & 0xFFFF for n in range(len(packets))]
    assert [bool(head[1] & 0x80) for head in heads] == [False] * (len(packets) - 1) + [True]
    assert {head[3] for head in heads} == {ticks & 0xFFFFFFFF}
    assert max(map(len, packets)) <= 1212


def test_the_description_names_the_parameter_sets() -> None:
    text = session_description(units(1)[0])
    assert re.search(r"profile-level-id=42[0-9a-f]{4};sprop-parameter-sets=[\w+/=]+,[\w+/=]+", text)
    assert "sprop" not in session_description(None)


# The channel.


def test_nothing_is_encoded_while_nobody_watches() -> None:
    channel, seen = VideoChannel(SETTINGS, overlay=False), list[AccessUnit]()
    channel.show(picture(0))
    leave = channel.watch(seen.append)
    channel.show(picture(1))
    assert [unit.is_key for unit in seen] == [True]
    leave()
    channel.show(picture(2))
    assert len(seen) == 1
    assert not channel.watched


def test_who_comes_later_begins_with_a_key_picture() -> None:
    channel, first, second = VideoChannel(SETTINGS, False), list[AccessUnit](), list[AccessUnit]()
    channel.watch(first.append)
    for number in range(3):
        channel.show(picture(number))
    channel.watch(second.append)
    channel.show(picture(3))
    assert [unit.is_key for unit in first] == [True, False, False, True]
    assert second[0].is_key


def test_the_overlay_is_drawn_where_it_is_wanted() -> None:
    track = Track(Box(80, 60, 40, 30), TrackState.TRACKING, 1.0, "test", 0.0, 0)
    sizes = []
    for overlay in (False, True):
        channel, seen = VideoChannel(SETTINGS, overlay), list[AccessUnit]()
        channel.watch(seen.append)
        channel.show(
            Picture(np.full((HEIGHT, WIDTH, 3), 90, np.uint8), 0, 0.0, (track,), ("IDLE",))
        )
        sizes.append(len(seen[0].data))
    assert sizes[1] > 2 * sizes[0]


def test_a_new_size_of_pictures_goes_on() -> None:
    channel, seen = VideoChannel(SETTINGS, False), list[AccessUnit]()
    channel.watch(seen.append)
    channel.show(picture(0))
    channel.show(Picture(np.zeros((90, 120, 3), np.uint8), 1, 0.1))
    assert [unit.is_key for unit in seen] == [True, True]
