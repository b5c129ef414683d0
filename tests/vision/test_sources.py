"""Recorded sources: every frame, its true time, and plain words where there is none."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from follower_vision.clock import SimulatedClock
from follower_vision.sources.frame_source import RealtimePlayback, SourceError
from follower_vision.sources.open import ImageFolder, natural_key, open_source
from follower_vision.sources.video_file import VideoFile


def picture(number: int, width: int = 64, height: int = 48) -> np.ndarray:
    image = np.full((height, width, 3), 20 + 8 * number, np.uint8)
    image[: height // 2, : width // 2] = (20, 40, 230)
    return image


def write_video(path, times_s, key_every=5, **options):
    with av.open(str(path), "w", options=options) as container:
        coding = {"g": str(key_every), "bf": "0", "sc_threshold": "0"}
        stream = container.add_stream("libx264", rate=30, options=coding)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, time_s in enumerate(times_s):
            frame = av.VideoFrame.from_ndarray(picture(number % 25), format="bgr24")
            frame.pts, frame.time_base = round(time_s * 1000), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_images(folder, names):
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        cv2.imwrite(str(folder / name), picture(number))
    return folder


def everything(source):
    with source:
        return list(iter(source.read, None))


def brightness(frame) -> float:
    return float(frame.image[30:, 40:].mean())


def test_a_video_gives_every_frame_in_bgr_with_its_own_time(tmp_path):
    times_s = [0.0, 0.04, 0.08, 0.2, 0.21, 0.5]
    path = write_video(tmp_path / "a.mp4", times_s)
    source = VideoFile(path)
    frames = everything(source)
    assert [f.captured_s for f in frames] == pytest.approx(times_s, abs=1e-3)
    assert [f.sequence for f in frames] == list(range(6))
    blue, green, red = frames[0].image[10, 10]
    assert red > 180 > 100 > max(blue, green)
    assert np.diff([brightness(f) for f in frames]).min() > 3
    assert source.problem is None


@pytest.mark.parametrize("kind", ["ts", "mkv", "mp4"])
def test_times_count_from_the_first_frame(tmp_path, kind):
    source = VideoFile(write_video(tmp_path / f"a.{kind}", 5.0 + np.arange(60) / 30))
    assert everything(source)[0].captured_s == 0
    assert source.problem is None


@pytest.mark.parametrize(
    ("kind", "patch"),
    [
        ("mp4", bytes(30)),  # a picture is decoded, with what FFmpeg makes of the gap
        ("ts", b""),  # packets of a transmission that were lost
    ],
)
def test_damage_that_ffmpeg_passes_over_is_told(tmp_path, kind, patch):
    path = write_video(tmp_path / f"a.{kind}", np.arange(60) / 30)
    whole = path.read_bytes()
    begin = len(whole) // 2 // 188 * 188
    path.write_bytes(whole[:begin] + patch + whole[begin + (len(patch) or 10 * 188) :])
    source = VideoFile(path)
    assert len(everything(source)) > 50
    assert "damaged in" in source.problem


def test_a_recording_that_begins_between_key_frames_is_not_called_cut_short(tmp_path):
    path = write_video(tmp_path / "a.ts", np.arange(60) / 30, key_every=40)
    whole = path.read_bytes()
    path.write_bytes(whole[len(whole) // 6 // 188 * 188 :])
    source = VideoFile(path)
    assert len(everything(source)) == 20
    assert source.problem is None


def test_a_title_that_is_no_utf_8_is_no_hindrance(tmp_path):
    """Cameras write it in whatever encoding their country had."""
    path = write_video(tmp_path / "a.mkv", [0.0, 0.1])
    path.write_bytes(path.read_bytes().replace(b"Lavf", b"\xe9avf"))
    assert len(everything(VideoFile(path))) == 2


@pytest.mark.parametrize("kind", ["mkv", "avi", "mov", "ts"])
def test_other_containers_work_too(tmp_path, kind):
    frames = everything(open_source(str(write_video(tmp_path / f"a.{kind}", np.arange(8) / 10))))
    assert len(frames) == 8
    times_s = [f.captured_s for f in frames]
    assert times_s[:7] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6], abs=0.05)


def test_a_video_that_was_cut_short_gives_what_there_is_and_says_so(tmp_path):
    path = write_video(tmp_path / "a.mp4", np.arange(100) / 30, movflags="faststart")
    whole = path.read_bytes()
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole[: len(whole) * 6 // 10])
    source = VideoFile(cut)
    frames = everything(source)
    assert 10 < len(frames) < 90
    assert "cut.mp4" in source.problem
    assert "copy it anew" in source.problem


def test_damage_in_the_middle_is_skipped_and_said(tmp_path):
    path = write_video(tmp_path / "a.ts", np.arange(60) / 30)
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 600] = bytes(600)
    path.write_bytes(data)
    frames = everything(VideoFile(path))
    assert len(frames) > 30
    assert frames[-1].captured_s > 1.5


def test_a_turned_phone_video_stands_upright(tmp_path):
    plain = write_video(tmp_path / "a.mp4", [0, 0.1, 0.2])
    data = bytearray(plain.read_bytes())
    header = data.index(b"tkhd") - 4
    one = (1 << 16).to_bytes(4, "big", signed=True)
    minus = (-(1 << 16)).to_bytes(4, "big", signed=True)
    zero, unit = bytes(4), (1 << 30).to_bytes(4, "big")
    matrix = zero + one + zero + minus + zero + zero + (48 << 16).to_bytes(4, "big") + zero + unit
    data[header + 48 : header + 84] = matrix
    turned = tmp_path / "turned.mp4"
    turned.write_bytes(data)
    frame = everything(VideoFile(turned))[0]
    assert (frame.width, frame.height) == (48, 64)
    # The red corner was at the top left; a quarter turn clockwise brings it to the top right.
    assert frame.image[10, 40, 2] > 180
    assert frame.image[10, 5, 2] < 100


def test_sound_that_begins_underway_does_not_disturb_the_end(tmp_path):
    """As a recorder that was not told of the sound writes it."""
    path = tmp_path / "late.flv"
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=30)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        sound = container.add_stream("pcm_s16le", rate=44100, layout="mono")
        for number in range(300):
            frame = av.VideoFrame.from_ndarray(picture(number % 25), format="bgr24")
            frame.pts, frame.time_base = number, Fraction(1, 30)
            container.mux(video.encode(frame))
        late = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        late.sample_rate, late.pts, late.time_base = 44100, 44100 * 9, Fraction(1, 44100)
        container.mux(sound.encode(late))
        container.mux(video.encode(None))
    content = bytearray(path.read_bytes())
    content[4] = 1  # the header promises video alone
    path.write_bytes(content)
    source = VideoFile(path)
    assert len(everything(source)) == 300
    assert source.problem is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        (b"", "empty"),
        (b"this is a letter, not a film\n" * 50, "not a video"),
        (bytes(range(256)) * 40, "not a video"),
    ],
)
def test_what_is_no_video_is_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "film.txt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SourceError, match=words) as error:
        open_source(str(path))
    assert "film.txt" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_video_without_its_index_is_refused(tmp_path):
    path = write_video(tmp_path / "a.mp4", np.arange(30) / 30)
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(SourceError, match="complete"):
        open_source(str(path))


def test_sound_alone_is_no_video(tmp_path):
    path = tmp_path / "a.wav"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
    with pytest.raises(SourceError, match="no video"):
        open_source(str(path))


def test_a_folder_is_read_in_natural_order_at_the_given_rate(tmp_path):
    folder = write_images(tmp_path, ["1.png", "2.jpg", "10.png", "11.bmp"])
    (folder / "notes.txt").write_text("not a picture")
    frames = everything(open_source(str(folder), folder_rate_hz=10))
    assert [round(brightness(f)) for f in frames] == pytest.approx([20, 28, 36, 44], abs=2)
    assert [f.captured_s for f in frames] == pytest.approx([0, 0.1, 0.2, 0.3])


def test_a_data_sets_img_folder_is_found(tmp_path):
    write_images(tmp_path / "img", ["000001.jpg", "000002.jpg"])
    assert ImageFolder(tmp_path).frame_count == 2


def test_what_a_mac_puts_beside_each_picture_is_none(tmp_path):
    folder = write_images(tmp_path, ["img1.png", "img2.png"])
    for name in ("img1.png", "img2.png"):
        (folder / f"._{name}").write_bytes(b"\0\5\x16\7Mac OS X")
    source = ImageFolder(folder)
    assert len(everything(source)) == 2
    assert source.problem is None


def test_natural_order_mixes_numbers_and_words():
    names = ["img10.png", "img2.png", "Img1.png", "a.png", "7.png"]
    ordered = sorted(map(Path, names), key=natural_key)
    assert [p.name for p in ordered] == ["7.png", "a.png", "Img1.png", "img2.png", "img10.png"]


def test_a_broken_picture_leaves_a_gap_and_a_word(tmp_path):
    folder = write_images(tmp_path, ["1.png", "2.png", "3.png"])
    (folder / "2.png").write_bytes(b"broken")
    source = ImageFolder(folder)
    assert [f.sequence for f in everything(source)] == [0, 2]
    assert "2.png" in source.problem


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: p / "nowhere", "no such folder"),
        (lambda p: p, "no pictures"),
    ],
)
def test_an_unsuitable_folder_is_refused(tmp_path, make, words):
    with pytest.raises(SourceError, match=words):
        ImageFolder(make(tmp_path))


def test_a_folder_of_broken_pictures_is_refused(tmp_path):
    (tmp_path / "1.png").write_bytes(b"broken")
    with pytest.raises(SourceError, match="not a readable picture"):
        ImageFolder(tmp_path)


@pytest.mark.parametrize("rate_hz", [0, -1, float("inf"), float("nan")])
def test_a_folder_needs_a_sensible_rate(tmp_path, rate_hz):
    with pytest.raises(SourceError, match="rate"):
        ImageFolder(write_images(tmp_path, ["1.png"]), rate_hz)


def test_closed_sources_give_nothing_more(tmp_path):
    for source in (
        VideoFile(write_video(tmp_path / "a.mp4", [0, 0.1])),
        ImageFolder(write_images(tmp_path / "f", ["1.png", "2.png"])),
    ):
        assert source.read() is not None
        source.close()
        assert source.read() is None


def test_paced_playback_keeps_the_recordings_times(tmp_path):
    clock = SimulatedClock(100.0)
    frames = everything(
        RealtimePlayback(VideoFile(write_video(tmp_path / "a.mp4", [0, 0.1, 0.4])), clock)
    )
    assert [f.captured_s for f in frames] == pytest.approx([100.0, 100.1, 100.4], abs=1e-3)
    assert clock.now() == pytest.approx(100.4, abs=1e-3)


def test_paced_playback_skips_what_a_late_reader_missed(tmp_path):
    clock = SimulatedClock(5.0)
    source = RealtimePlayback(
        ImageFolder(write_images(tmp_path, [f"{i}.png" for i in range(10)]), 10), clock
    )
    assert source.read().sequence == 0
    clock.sleep_until(5.45)
    late = source.read()
    assert (late.sequence, late.captured_s) == (4, pytest.approx(5.4))
    assert source.skipped == 3
    assert source.read().sequence == 5
