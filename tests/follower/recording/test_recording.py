"""What is recorded is read again, to the last bit; nothing is added and nothing secret."""

import json
import math
import struct
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.recording import FlightConfig, Recorder, open_flight
from follower.recording.codec import decode, encode, json_schema
from follower.recording.config import processor_features, without_secrets
from follower.recording.messages import MESSAGES, StepRecord
from follower.recording.tlog import Direction, TlogWriter, read_tlog
from follower.settings.settings import Settings
from follower_control.common.transport import MemoryTransport
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_vision.clock import SimulatedClock
from follower_vision.images.frame import Frame

FlySmall = Callable[..., Any]
any_float = st.floats(allow_nan=True, allow_infinity=True)


def bits(value: float) -> bytes:
    return b"nan" if math.isnan(value) else struct.pack(">d", value)


@given(st.tuples(any_float, any_float, any_float, any_float))
def test_every_float_comes_back_bit_for_bit_also_those_json_does_not_know(
    values: tuple[float, float, float, float],
) -> None:
    setpoint = VelocitySetpoint(*values)
    data = encode(setpoint)
    json.loads(data, parse_constant=pytest.fail)  # plain JSON: no bare NaN or Infinity
    again = decode(VelocitySetpoint, data)
    assert [bits(value) for value in again.values] == [bits(value) for value in values]


def test_arrays_keep_their_shape_and_bits() -> None:
    covariance = np.random.default_rng(1).normal(size=(6, 6))
    numbers = (1.0, 0.1, -0.2, 1 / 3, 0.0, -0.0, 5e-324)
    estimate = TargetEstimate(*numbers, covariance, 0.9, BearingFrame.WORLD)
    again = decode(TargetEstimate, encode(estimate))
    assert again.covariance.tobytes() == covariance.tobytes()
    assert replace(again, covariance=covariance).azimuth_rate_rad_s == 0.0
    assert again.frame is BearingFrame.WORLD


def test_numpy_scalars_are_written_as_what_they_are_worth() -> None:
    value = np.float32(0.1)
    again = decode(VelocitySetpoint, encode(VelocitySetpoint(value, np.float64(0.2))))
    assert again.forward_m_s == float(value)
    assert again.right_m_s == 0.2


def test_a_reason_recorded_under_its_name_of_before_is_read_as_the_present_one() -> None:
    reason = SupervisorReason.AWAITING_CONSENT
    step = StepRecord(1.0, 0.0, 0.0, SupervisorState.RELEASED, reason)
    data = encode(step)
    assert decode(StepRecord, data) == step
    before = data.replace(reason.encode(), b"let go, waiting for consent")
    assert before != data
    assert decode(StepRecord, before) == step
    with pytest.raises(ValueError, match="StepRecord"):
        decode(StepRecord, data.replace(reason.encode(), b"nobody knows"))


def same(a: Any, b: Any) -> bool:
    """Compare dataclasses of any depth; arrays by their bits."""
    if isinstance(a, np.ndarray):
        return bool(a.tobytes() == b.tobytes())
    if hasattr(a, "__dataclass_fields__"):
        names = [field.name for field in fields(a)]
        return type(a) is type(b) and all(same(getattr(a, n), getattr(b, n)) for n in names)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)


def test_the_log_comes_back_as_it_was_in_memory(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    assert same(flight.log.tracks, small_flight.log.tracks)
    assert same(flight.log.controls, small_flight.log.controls)
    assert same(flight.log.events, small_flight.log.events)
    assert any(record.estimate is not None for record in flight.log.controls)
    assert len(flight.selections) == 1
    assert flight.observations
    assert flight.remarks == []


def test_lossless_video_is_what_vision_saw_with_numbers_and_times(small_flight: Any) -> None:
    pictures = list(open_flight(small_flight.folder).pictures())
    assert len(pictures) == len(small_flight.frames)
    for picture, frame in zip(pictures, small_flight.frames, strict=True):
        assert (picture.captured_s, picture.sequence) == (frame.captured_s, frame.sequence)
        assert np.array_equal(picture.image, frame.image)


@pytest.mark.parametrize(("width", "height"), [(161, 119), (160, 120), (33, 17)])
@pytest.mark.parametrize("video", ["lossless", "h264"])
def test_frames_of_odd_sizes_keep_their_size(
    tmp_path: Path, video: str, width: int, height: int
) -> None:
    settings = Settings.model_validate({"recorder": {"video": video, "keep_free_mb": 0}})
    config = FlightConfig.of("real", settings)
    ramp = np.add.outer(np.arange(height), np.arange(width)) % 200
    image = np.stack([ramp, ramp + 20, ramp + 40], axis=2).astype(np.uint8)
    with Recorder(tmp_path, config, SimulatedClock(), settings.recorder, threaded=False) as one:
        for number in range(4):
            one.add_frame(Frame(image, 0.1 * number, number), 0.1 * number)
    pictures = list(open_flight(tmp_path).pictures())
    assert [picture.image.shape for picture in pictures] == [(height, width, 3)] * 4
    apart = np.abs(pictures[2].image.astype(int) - image)
    assert apart.mean() < (6 if video == "h264" else 1e-9)


def test_matroska_times_are_the_capture_times_to_the_millisecond(small_flight: Any) -> None:
    with av.open(str(small_flight.folder / "video.mkv")) as container:
        times = [picture.time for picture in container.decode(video=0)]
    wanted = [frame.captured_s - small_flight.frames[0].captured_s for frame in small_flight.frames]
    assert times == pytest.approx(wanted, abs=0.0006)


@pytest.mark.slow
def test_a_flight_in_lockstep_is_recorded_the_same_each_time(
    fly_small: FlySmall, tmp_path: Path
) -> None:
    """Apart from how long the computer worked, which no decision depends on."""

    def content(name: str) -> list[Any]:
        fly_small(tmp_path / name, seconds=1.0)
        rows = []
        for time_s, message in open_flight(tmp_path / name).messages():
            still = replace(message, busy_s=0.0) if hasattr(message, "busy_s") else message
            rows.append((time_s, type(message).__name__, encode(still)))
        return rows

    assert content("one") == content("two")
    for name in ("video.mkv", "mavlink.tlog", "config.yaml"):
        one, two = ((tmp_path / folder / name).read_bytes() for folder in ("one", "two"))
        # Matroska carries a random number that identifies the file.
        assert one == two or (name == "video.mkv" and abs(len(one) - len(two)) < 64)


def test_other_programs_read_the_log(small_flight: Any) -> None:
    """With the format's own reader: an index, a schema for each channel, messages that obey it."""
    with (small_flight.folder / "flight.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert {channel.topic for channel in summary.channels.values()} == {
            message.topic for message in MESSAGES
        }
        count = 0
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert_obeys(json.loads(message.data), json.loads(schema.data))
            count += 1
    assert count == summary.statistics.message_count > 500


PYTHON = {"number": (int, float), "integer": int, "string": str, "boolean": bool, "array": list}


def assert_obeys(plain: Any, schema: dict[str, Any]) -> None:
    if schema["type"] == "object":
        assert set(schema["required"]) <= set(plain) <= set(schema["properties"])
        for name, part in plain.items():
            assert_obeys(part, schema["properties"][name])
        return
    infinite = schema["type"] == "number" and plain in ("NaN", "Infinity", "-Infinity")
    assert infinite or isinstance(plain, PYTHON[schema["type"]]), (plain, schema)
    if schema["type"] == "array":
        assert schema.get("minItems", 0) <= len(plain) <= schema.get("maxItems", math.inf)
        for item in plain:
            assert_obeys(item, schema["items"])
    assert plain in schema.get("enum", [plain])


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.topic)
def test_every_field_of_the_table_says_what_it_is(message: Any) -> None:
    described = json_schema(message)["properties"]
    silent = [name for name, part in described.items() if "description" not in part]
    assert not silent


def test_pymavlink_reads_the_telemetry_log(small_flight: Any) -> None:
    log = mavutil.mavlink_connection(str(small_flight.folder / "mavlink.tlog"))
    first = log.recv_match(type="ATTITUDE")
    last = first
    count = 1
    while (message := log.recv_match(type="ATTITUDE")) is not None:
        last, count = message, count + 1
    assert count == len(small_flight.log.controls)
    assert last._timestamp - first._timestamp == pytest.approx(2.98, abs=1e-5)
    log.close()


def test_both_directions_are_in_the_telemetry_log(small_flight: Any) -> None:
    packets = list(open_flight(small_flight.folder).packets())
    assert {packet.direction for packet in packets} == set(Direction)
    times = [packet.time_s for packet in packets if packet.direction is Direction.RECEIVED]
    wanted = [record.time_s for record in small_flight.log.controls]
    assert times == pytest.approx(wanted, abs=4e-6)


@pytest.mark.parametrize("noise", [b"", b"\xfd\x50", b"\xfd\x50\0"])
def test_a_signing_key_is_never_written(tmp_path: Path, noise: bytes) -> None:
    """Nor behind noise that begins as a packet would that is longer than it."""
    key = bytes(range(100, 132))
    codec = mavlink.MAVLink(None, 1, 191)
    secret = mavlink.MAVLink_setup_signing_message(1, 1, key, 12345).pack(codec)
    harmless = mavlink.MAVLink_system_time_message(1, 2).pack(codec)
    settings = Settings()
    run = {
        "source": "rtsp://pilot:hunter2@10.0.0.2/live",
        "signing_key": "c0ffee",
        "link": {"password": "swordfish", "baud": 57600},
    }
    clock = SimulatedClock()
    config = FlightConfig.of("real", settings, run=run)
    with Recorder(tmp_path, config, clock, threaded=False) as recorder:
        ours, theirs = MemoryTransport.pair()
        link = recorder.transport(ours)
        link.send(secret[:7])
        link.send(secret[7:])
        link.send(harmless)
        theirs.send(noise + secret + harmless + harmless)
        link.receive()
    for file in tmp_path.iterdir():
        content = file.read_bytes()
        for part in (key, key[:8], b"hunter2", b"c0ffee", b"swordfish"):
            assert part not in content, file.name
    assert [packet.data for packet in open_flight(tmp_path).packets()] == 3 * [harmless]
    assert yaml.safe_load((tmp_path / "config.yaml").read_text())["run"] == {
        "source": "rtsp://10.0.0.2/live",
        "link": {"baud": 57600},
    }
    with (tmp_path / "flight.mcap").open("rb") as file:
        names = {part.name: part.metadata for part in make_reader(file).iter_metadata()}
    assert "hunter2" not in names["flight"]["config"]


def test_secrets_are_left_out_wherever_they_stand() -> None:
    plain = {"a": [{"API_TOKEN": 1, "kept": "udp://u:p@h:1 and http://x@y/z"}], "tokens_left": 3}
    assert without_secrets(plain) == {"a": [{"kept": "udp://h:1 and http://y/z"}]}


@pytest.mark.parametrize(
    ("address", "kept"),
    [
        ("rtsp://us:p@ss@h:554/live", "rtsp://h:554/live"),
        ("rtsp://h/user=a&password=swordfish&channel=1", "rtsp://h/user=a&password=&channel=1"),
        (
            "follower fly --camera 'http://h/v?token=swordfish'",
            "follower fly --camera 'http://h/v?token='",
        ),
        (
            "gst:rtspsrc location=rtsp://h user-pw=swordfish ! x",
            "gst:rtspsrc location=rtsp://h user-pw= ! x",
        ),
        (
            "--set servo.distance_m=10 udp://h:14550 a@b",
            "--set servo.distance_m=10 udp://h:14550 a@b",
        ),
    ],
)
def test_a_cameras_password_is_left_out_wherever_it_stands(address: str, kept: str) -> None:
    assert without_secrets({"source": address}) == {"source": kept}


def test_a_cut_telemetry_log_is_read_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "x.tlog"
    packet = mavlink.MAVLink_system_time_message(1, 2).pack(mavlink.MAVLink(None, 1, 1))
    with TlogWriter(path, 10**18) as writer:
        for number in range(5):
            writer.write(packet, Direction.SENT, 0.5 * number)
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        assert len(list(read_tlog(path, 10**18))) == length // (8 + len(packet))


def test_behind_damaged_bytes_a_telemetry_log_goes_on(tmp_path: Path) -> None:
    path, codec = tmp_path / "x.tlog", mavlink.MAVLink(None, 1, 1)
    with TlogWriter(path, 10**18) as writer:
        for number in range(50):
            message = mavlink.MAVLink_system_time_message(number, number)
            writer.write(message.pack(codec), Direction.SENT, 0.5 * number)
    whole = list(read_tlog(path, 10**18))
    data = path.read_bytes()
    size = len(data) // 50
    for number in range(10, 20):
        at = size * number + number  # through the time, the head, the content
        broken = data[:at] + b"\x00\xfd\xfe" + data[at + 3 :]
        path.write_bytes(broken[: -size // 2])
        remarks: list[str] = []
        found = list(read_tlog(path, 10**18, remarks))
        assert found[:9] == whole[:9]
        assert found[-28:] == whole[21:49]
        assert "bytes of x.tlog are cut off or damaged" in remarks[0]


def test_the_configuration_tells_what_flew(small_flight: Any) -> None:
    config = open_flight(small_flight.folder).config
    assert config.versions["numpy"] == np.__version__
    named = {"python", "machine", "libc", "opencv-python-headless", "onnxruntime", "filterpy"}
    assert named <= config.versions.keys()
    assert set(config.processor["features"].split()) == {*processor_features()}
    assert config.processor["model"]
    assert config.settings["recorder"]["video"] == "lossless"
    assert Settings.model_validate(config.settings).control_rate_hz == 50
