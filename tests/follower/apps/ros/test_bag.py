"""A recorded flight becomes a bag that others open, and a bag becomes a flight again."""

import json
import math
import re
import subprocess
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not here: pip install -e .[ros]")

from mcap.reader import make_reader
from program import FOLLOWER, output_of
from rosbags.convert.converter import convert
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from follower import open_flight, simulate
from follower.apps.ros.bag import CLIP, TABLE, pack, read_bag, unpack
from follower.apps.ros.conversion import attitude_of, turned_to_body
from follower.apps.viewers.scene import FlightScene
from follower.recording import RecordedFlight
from follower.recording.telemetry_logs import read_telemetry
from follower.settings.settings import configs_folder
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.video_file import VideoFile

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = ["duration_s=14", "camera.rate_hz=10"]
    out = tmp_path_factory.mktemp("runs")
    return simulate("winding", scene=scene, overrides=["detector=null"], out=out).folder


@pytest.fixture(scope="module")
def bag(flight: Path) -> Path:
    return pack(flight, flight / "bag")


def test_the_bag_is_mcap_with_the_schemas_of_ros(flight: Path, bag: Path) -> None:
    with (bag / "bag.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert {one.name for one in summary.schemas.values()} >= {
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Imu",
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/TwistStamped",
        "tf2_msgs/msg/TFMessage",
        "vision_msgs/msg/Detection2D",
        "diagnostic_msgs/msg/DiagnosticArray",
    }
    assert {one.message_encoding for one in summary.channels.values()} == {"cdr"}
    recorded = open_flight(flight)
    with AnyReader([bag]) as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
    assert counts["/image/compressed"] == len(recorded.frames)
    assert counts["/follower/setpoint"] == sum(one.sent for one in recorded.log.controls)


def test_by_the_bags_own_definitions_each_message_reads_at_its_time(bag: Path) -> None:
    """Nothing that this computer knows of ROS is used: a viewer knows none of it."""
    stores, kinds = {}, set()
    with (bag / "bag.mcap").open("rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            if schema.name not in stores:
                stores[schema.name] = get_typestore(Stores.EMPTY)
                stores[schema.name].register(get_types_from_msg(schema.data.decode(), schema.name))
            told = stores[schema.name].deserialize_cdr(message.data, schema.name)
            assert stores[schema.name].serialize_cdr(told, schema.name) == message.data
            one: Any = getattr(told, "transforms", [told])[0]
            if hasattr(one, "header"):
                stamp = one.header.stamp
                late_ns = message.log_time - stamp.sec * 1_000_000_000 - stamp.nanosec
                assert 0 <= late_ns <= (0 if one is told else 20_000_000)
                kinds.add(schema.name)
    assert stores.keys() - kinds == {"sensor_msgs/msg/RegionOfInterest"}


def test_the_layout_names_what_is_in_the_bag(bag: Path) -> None:
    layout = json.loads((configs_folder() / "viewers" / "bag.json").read_text("utf-8"))
    panels = layout["configById"]
    assert sorted(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))) == sorted(panels)
    with AnyReader([bag]) as reader:
        kinds = {one.topic: one.msgtype.rpartition("/")[2] for one in reader.connections}
    camera, world = panels["Image!camera"]["imageMode"], panels["3D!map"]
    assert kinds[camera["imageTopic"]] == "CompressedImage"
    assert kinds[camera["calibrationTopic"]] == "CameraInfo"
    assert [kinds[one] for one in world["topics"]] == [
        "PoseWithCovarianceStamped",
        "CameraInfo",
        "CompressedImage",
    ]
    last = messages(bag, "/tf")[-1].transforms
    assert {world["fixedFrame"]} == {one.header.frame_id for one in last}
    assert world["followTf"] in {one.child_frame_id for one in last}
    for panel in panels.values():
        assert kinds[panel.get("topicToRender", "/diagnostics")] == "DiagnosticArray"
        for path in panel.get("paths", ()):
            topic, *names = path["value"].split(".")
            assert isinstance(reduce(getattr, names, messages(bag, topic)[-1]), float), path
    (track,) = messages(bag, "/follower/track")[-1].status
    shown = panels["DiagnosticStatusPanel!track"]
    assert (shown["selectedHardwareId"], shown["selectedName"]) == (track.hardware_id, track.name)


def messages(bag: Path, topic: str) -> list[Any]:
    """Return a topic's messages, in the order of time."""
    with AnyReader([bag]) as reader:
        wanted = [one for one in reader.connections if one.topic == topic]
        return [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(wanted)]


def since(message: Any, flight: RecordedFlight) -> float:
    """Return a message's time on the flight's clock, in seconds."""
    stamp = message.header.stamp
    return stamp.sec + stamp.nanosec * 1e-9 - flight.config.epoch_ns * 1e-9


def test_the_bag_has_the_lens_with_each_picture(flight: Path, bag: Path) -> None:
    infos, lens = messages(bag, "/camera_info"), FlightScene(open_flight(flight)).camera
    pictures = messages(bag, "/image/compressed")
    assert [str(one.header) for one in infos] == [str(one.header) for one in pictures]
    info = infos[-1]
    assert (info.header.frame_id, info.width, info.height) == ("camera", lens.width, lens.height)
    k = [lens.fx, 0, lens.cx - 0.5, 0, lens.fy, lens.cy - 0.5, 0, 0, 1]
    assert info.k.tolist() == pytest.approx(k)
    assert info.p.reshape(3, 4)[:, :3].ravel().tolist() == pytest.approx(k)
    assert info.d.tolist() == pytest.approx(lens.distortion)


def test_the_bag_has_each_tracks_box(flight: Path, bag: Path) -> None:
    recorded = open_flight(flight)
    tracks = [one for one in recorded.log.tracks if one.track is not None]
    boxes = messages(bag, "/follower/detection")
    assert len(boxes) == len(tracks) > 0
    for record, message in zip(tracks, boxes, strict=True):
        track, place = record.track, message.bbox.center.position
        assert message.header.frame_id == "camera"
        assert since(message, recorded) == pytest.approx(record.captured_s, abs=1e-5)
        box = place.x, place.y, message.bbox.size_x, message.bbox.size_y
        assert box == pytest.approx((track.box.cx, track.box.cy, track.box.width, track.box.height))
        (result,) = message.results
        assert result.hypothesis.class_id == str(track.state)
        assert result.hypothesis.score == pytest.approx(track.confidence)
        assert result.pose.pose.orientation.w == 1.0


def test_the_bag_says_that_there_is_no_track_and_warns_of_a_release(
    flight: Path, bag: Path
) -> None:
    recorded = open_flight(flight)
    told, boxes = messages(bag, "/follower/track"), messages(bag, "/follower/roi")
    assert len(told) == len(boxes) == len(recorded.log.tracks)
    for record, message, box in zip(recorded.log.tracks, told, boxes, strict=True):
        said = "none" if record.track is None else str(record.track.state)
        assert (message.status[0].message, message.header.frame_id) == (said, "camera")
        assert (box.width > 0) == (record.track is not None)
    released = [one.state == "released" for one in recorded.log.controls]
    assert any(released)
    health = messages(bag, "/diagnostics")
    assert [one.status[0].level for one in health] == released
    assert {one.header.frame_id for one in health} == {""}


def test_the_bag_has_the_targets_place_in_the_map(flight: Path, bag: Path) -> None:
    recorded = open_flight(flight)
    scene = FlightScene(recorded)
    fixes = [fix for one in recorded.log.controls if (fix := scene.fix(one)) is not None]
    told = messages(bag, "/follower/target")
    assert len(told) == len(fixes) > 0
    fix, message = fixes[-1], told[-1]
    place, (north, east, down) = message.pose.pose.position, fix.position_m
    assert message.header.frame_id == "map"
    assert since(message, recorded) == pytest.approx(fix.time_s, abs=1e-5)
    assert (place.x, place.y, place.z) == pytest.approx((east, north, -down))
    variances = message.pose.covariance.reshape(6, 6)
    assert variances[0, 0] == pytest.approx(fix.covariance[1, 1])
    assert variances[0, 2] == pytest.approx(-fix.covariance[1, 2])
    true = recorded.truth[-1].target_position_m
    began = recorded.truth[0].vehicle.position_m
    assert math.hypot(place.y + began[0] - true[0], place.x + began[1] - true[1]) < 8.0


def test_transforms_put_the_target_into_the_middle_of_the_box(flight: Path, bag: Path) -> None:
    """Through the frames of the bag alone: from the map into the camera, by its lens a pixel."""
    moved = [one for message in messages(bag, "/tf") for one in message.transforms]
    assert {one.header.frame_id for one in moved} == {"map"}
    last = {one.child_frame_id: one.transform for one in moved}
    assert last.keys() == {"base_link", "camera", "follower_target"}
    vehicle = open_flight(flight).log.controls[-1].vehicle
    body = last["base_link"]
    assert attitude_of(body.rotation) == pytest.approx(vehicle.attitude.numbers[:3], abs=0.02)
    assert body.translation.z == pytest.approx(-vehicle.position.down_m, abs=0.2)
    camera, target = last["camera"], last["follower_target"].translation
    e, n, u = (getattr(target, a) - getattr(camera.translation, a) for a in "xyz")
    right, down, forward = turned_to_body(camera.rotation, (n, e, -u))
    k = messages(bag, "/camera_info")[-1].k.reshape(3, 3)
    x, y, _ = k @ (right / forward, down / forward, 1.0)
    box = messages(bag, "/follower/detection")[-1].bbox
    assert x == pytest.approx(box.center.position.x, abs=max(box.size_x, 20.0))
    assert y == pytest.approx(box.center.position.y, abs=max(box.size_y, 20.0))


def test_each_message_of_tf_has_all_frames_that_are_known(bag: Path) -> None:
    """A viewer that jumps in time has the last message before it only."""
    moved = [one.transforms for one in messages(bag, "/tf")]
    names, vehicle = (
        [[one.child_frame_id for one in each] for each in moved],
        ["base_link", "camera"],
    )
    seen = names.count([*vehicle, "follower_target"])
    assert 0 < seen < len(names) == len(messages(bag, "/odometry"))
    assert names == [vehicle] * (len(names) - seen) + [[*vehicle, "follower_target"]] * seen
    places = {str(one.header): one.pose.pose.position for one in messages(bag, "/follower/target")}
    for *_, target in moved[-seen:]:
        place, move = places[str(target.header)], target.transform.translation
        assert (move.x, move.y, move.z) == (place.x, place.y, place.z)


def test_the_lens_of_a_bag_of_ros_1_is_known_too(bag: Path, tmp_path: Path) -> None:
    known, new = read_bag(of_ros_1(bag, tmp_path)), read_bag(bag)
    assert known.lens == new.lens != {}


def of_ros_1(bag: Path, folder: Path) -> Path:
    path, topics = folder / "flight.bag", ("/image/compressed", "/camera_info", "/imu")
    store, nothing = get_typestore(Stores.ROS1_NOETIC), ("", 0, None, "", None)
    convert([bag], path, *nothing, store, (), topics, (), ())
    return path


def test_a_bag_of_ros_1_is_unpacked_beside_it_and_writes_over_nothing(
    bag: Path, tmp_path: Path
) -> None:
    path = of_ros_1(bag, tmp_path)
    assert "follower import" in output_of("ros-bag", str(path))
    kept = (tmp_path / "unpacked" / CLIP).read_bytes()
    with pytest.raises(SourceError, match="exists already"):
        unpack(path, tmp_path / "unpacked")
    assert (tmp_path / "unpacked" / CLIP).read_bytes() == kept


def test_the_import_of_the_bag_knows_the_lens(flight: Path, bag: Path, tmp_path: Path) -> None:
    flown = FlightScene(open_flight(flight)).camera
    output_of("import", str(bag), "--out", str(tmp_path))
    (folder,) = tmp_path.glob("import-*")
    lens = FlightScene(open_flight(folder)).camera
    assert (lens.width, lens.fx, lens.cx) == pytest.approx((flown.width, flown.fx, flown.cx))
    assert lens.distortion == flown.distortion


def test_heights_count_from_the_first_fix_that_has_one(tmp_path: Path) -> None:
    """GPS receivers tell NaN, or no fix, until they know their place."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    with Writer(tmp_path / "bag", version=9) as writer:
        image, place = (
            writer.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=store)
            for topic, kind in (("/image", "Image"), ("/fix", "NavSatFix"))
        )
        for n, (status, height_m) in enumerate([(-1, math.nan), (0, math.nan), (0, 500), (0, 507)]):
            header = kinds["Header"](kinds["Time"](1000 + n, 0), "")
            grey = kinds["Image"](header, 1, 1, "mono8", 0, 1, np.zeros(1, np.uint8))
            fixed = kinds["NavSatStatus"](status, 1)
            fix = kinds["NavSatFix"](header, fixed, 47.0, 8.0, height_m, np.zeros(9), 0)
            for topic, one in ((image, grey), (place, fix)):
                data = store.serialize_cdr(one, one.__msgtype__)
                writer.write(topic, (1000 + n) * 10**9, data)
    log = read_bag(tmp_path / "bag")
    assert [(one.time_s, -one.down_m) for one in log.positions] == [(2.0, 0.0), (3.0, 7.0)]


def test_what_comes_back_is_what_was_flown(flight: Path, bag: Path, tmp_path: Path) -> None:
    words = unpack(bag, tmp_path)
    assert words.startswith("follower import")
    recorded = open_flight(flight)
    log = read_telemetry(tmp_path / TABLE)
    flown = [one for record in recorded.log.controls for one in record.attitudes]
    assert len(log.attitudes) == pytest.approx(len(flown), abs=2)
    assert log.attitudes[-1].yaw_rad == pytest.approx(flown[-1].yaw_rad, abs=1e-6)
    assert log.positions[-1].down_m == pytest.approx(
        recorded.log.controls[-1].vehicle.position.down_m, abs=0.2
    )
    with VideoFile(tmp_path / CLIP) as video:
        frames = 0
        while video.read() is not None:
            frames += 1
    assert frames == len(recorded.frames)


def test_what_is_no_bag_or_exists_already_is_refused(flight: Path, bag: Path) -> None:
    with pytest.raises(SourceError, match="exists already"):
        pack(flight, bag)
    (flight / "broken").mkdir()
    (flight / "broken" / "metadata.yaml").write_text("no: bag")
    command = [*FOLLOWER, "ros-bag", str(flight / "broken")]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 2
    assert "cannot be read as a bag" in result.stderr
    assert not (flight / "broken" / "unpacked").exists()
