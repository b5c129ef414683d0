"""A recorded flight as a rosbag2 in MCAP, and a bag as what `follower import` takes."""

import csv
import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from follower.apps.ros.conversion import (
    TARGET_FRAME,
    attitude_of,
    fill_attitude,
    fill_detection,
    fill_fix,
    fill_info,
    fill_region,
    fill_turn,
    fill_twist,
    fill_vector,
    image_of,
    lens_of,
    track_values,
    turned_to_body,
    turned_to_world,
)
from follower.apps.viewers.scene import FlightScene
from follower.flight.log import ControlRecord, TrackRecord
from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import open_flight
from follower.recording.telemetry_logs.readers import ANGLES, MODE, PLACE, RATES, TIME, read_csv
from follower.recording.telemetry_logs.samples import TelemetryLog, TelemetrySamples
from follower.recording.video_writer import VIDEO
from follower_control.vehicle.state import Attitude, LocalPosition
from follower_vision.drawing.video_writer import VideoWriter
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself, SourceError
from follower_vision.trackers.track import TrackState

TABLE, CLIP = "telemetry.csv", "video.mp4"
_STORE = get_typestore(Stores.ROS2_JAZZY)
_T: dict[str, Any] = _STORE.types
_VISION = {
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "Detection2D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox2D bbox\nstring id"
    ),
}
"""Of vision_msgs 4, which rosbags does not know."""
for _name, _text in _VISION.items():
    _STORE.register(get_types_from_msg(_text, f"vision_msgs/msg/{_name}"))
_QUATERNION = "geometry_msgs/msg/Quaternion"
_QUALITY = 92
_OK, _WARN = 0, 1


def _new(kind: str, **fields: Any) -> Any:
    """Return a message whose other fields are zeros, empty, or no turn, as rclpy makes them."""
    if kind == _QUATERNION:
        fields = {"w": 1.0, **fields}
    others = [one for one in _STORE.fielddefs[kind][1] if one[0] not in fields]
    return _T[kind](**{name: _zero(*of) for name, of in others}, **fields)


def _zero(node: Nodetype, of: Any) -> Any:
    if node is Nodetype.NAME:
        return _new(of)
    if node is Nodetype.BASE:
        return "" if of[0] == "string" else 0
    (inner, (name, *_)), length = of
    return np.zeros(length, name) if inner is Nodetype.BASE and name != "string" else []


class _Bag:
    """A bag that is being written, with a topic for each kind of message."""

    def __init__(self, writer: Writer, epoch_ns: int) -> None:
        self._writer, self._epoch_ns = writer, epoch_ns
        self._topics: dict[str, Any] = {}

    def stamp_ns(self, time_s: float) -> int:
        return max(self._epoch_ns + round(time_s * 1e9), 0)

    def new(self, kind: str, time_s: float, frame_id: str, **fields: Any) -> Any:
        """Return a message with a header, and zeros."""
        message = _new(kind, **fields)
        message.header.frame_id, stamp = frame_id, message.header.stamp
        stamp.sec, stamp.nanosec = divmod(self.stamp_ns(time_s), 1_000_000_000)
        return message

    def write(self, topic: str, message: Any, time_s: float) -> None:
        kind = message.__msgtype__
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(topic, kind, typestore=_STORE)
        data = _STORE.serialize_cdr(message, kind)
        self._writer.write(self._topics[topic], self.stamp_ns(time_s), data)

    def transform(self, child: str, time_s: float, place: Any, turn: Any = None) -> Any:
        """Return where a frame is in the map, and how it is turned, for /tf."""
        kind = "geometry_msgs/msg/TransformStamped"
        message = self.new(kind, time_s, "map", child_frame_id=child)
        move = message.transform
        fill_vector(move.translation, place.x, place.y, place.z)
        if turn is not None:
            move.rotation = turn
        return message


def pack(flight: Path, out: Path) -> Path:
    """Write a flight as a bag; return its folder.

    Topics as the node has them: image/compressed, camera_info, imu, odometry, follower/roi,
    follower/track, follower/detection, follower/target, follower/setpoint, /diagnostics; and /tf
    of vehicle, camera and target.

    Args:
        flight: its folder.
        out: must not exist yet.

    Raises:
        FlightFileError: it is no flight, or its settings are not understood.
        SourceError: `out` exists.
    """
    recorded = open_flight(flight)
    scene = FlightScene(recorded)
    if out.exists():
        raise SourceError(f"{out}: exists already; give another --out")
    with Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        bag = _Bag(writer, recorded.config.epoch_ns)
        if (recorded.folder / VIDEO).is_file():
            for frame in recorded.pictures():
                _pack_picture(bag, frame, scene)
        lost = {
            t.sequence for t in recorded.log.tracks if t.track and t.track.state == TrackState.LOST
        }
        position: LocalPosition | None = None
        for record in recorded.log.controls:
            for attitude in record.attitudes:
                _pack_attitude(bag, attitude)
            if record.vehicle.position not in (None, position) and record.vehicle.attitude:
                position = record.vehicle.position
                _pack_position(bag, position, record.vehicle.attitude, record, scene)
            _pack_control(bag, record, scene)
            warns = record.state == SupervisorState.RELEASED or record.track_sequence in lost
            said = f"{record.state}: {record.reason}"
            status = _status("follower: supervisor", said, {}, _WARN if warns else _OK)
            _pack_status(bag, "/diagnostics", status, record.time_s)
        for track in recorded.log.tracks:
            _pack_track(bag, track)
    return out


def _pack_picture(bag: _Bag, frame: Frame, scene: FlightScene) -> None:
    time_s, lens = frame.captured_s, scene.camera
    good, data = cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if good:
        kind = "sensor_msgs/msg/CompressedImage"
        picture = bag.new(kind, time_s, "camera", format="jpeg", data=data.ravel())
        bag.write("/image/compressed", picture, time_s)
    if lens is not None:
        distortion = np.array(lens.distortion)
        info = bag.new("sensor_msgs/msg/CameraInfo", time_s, "camera", d=distortion)
        fill_info(info, lens.resized(*frame.image.shape[1::-1]))
        bag.write("/camera_info", info, time_s)


def _pack_attitude(bag: _Bag, a: Attitude) -> None:
    message = bag.new("sensor_msgs/msg/Imu", a.time_s, "base_link")
    fill_attitude(message.orientation, (a.roll_rad, a.pitch_rad, a.yaw_rad))
    turn = message.angular_velocity
    fill_vector(turn, a.roll_rate_rad_s, -a.pitch_rate_rad_s, -a.yaw_rate_rad_s)
    message.linear_acceleration_covariance[0] = -1.0
    bag.write("/imu", message, a.time_s)


def _pack_position(
    bag: _Bag, p: LocalPosition, a: Attitude, record: ControlRecord, scene: FlightScene
) -> None:
    message = bag.new("nav_msgs/msg/Odometry", p.time_s, "map", child_frame_id="base_link")
    pose = message.pose.pose
    fill_vector(pose.position, p.east_m, p.north_m, -p.down_m)
    fill_attitude(pose.orientation, (a.roll_rad, a.pitch_rad, a.yaw_rad))
    body = turned_to_body(pose.orientation, (p.north_m_s, p.east_m_s, p.down_m_s))
    fill_vector(message.twist.twist.linear, *body)
    bag.write("/odometry", message, p.time_s)
    frames = [bag.transform("base_link", p.time_s, pose.position, pose.orientation)]
    eye, fix = scene.eye(record), scene.fix(record)
    if eye is not None:
        turn = _new(_QUATERNION)
        fill_turn(turn, eye.turn)
        frames.append(bag.transform("camera", p.time_s, pose.position, turn))
    if fix is not None:
        north, east, down = fix.position_m
        place = SimpleNamespace(x=east, y=north, z=-down)
        frames.append(bag.transform(TARGET_FRAME, fix.time_s, place))
    # In one message: of each topic, a viewer that jumps in time has the last one only.
    bag.write("/tf", _new("tf2_msgs/msg/TFMessage", transforms=frames), record.time_s)


def _pack_control(bag: _Bag, record: ControlRecord, scene: FlightScene) -> None:
    if record.sent:
        message = bag.new("geometry_msgs/msg/TwistStamped", record.time_s, "base_link")
        fill_twist(message.twist, record.allowed)
        bag.write("/follower/setpoint", message, record.time_s)
    fix = scene.fix(record)
    if fix is not None:
        target = bag.new("geometry_msgs/msg/PoseWithCovarianceStamped", fix.time_s, "map")
        fill_fix(target.pose, fix)
        bag.write("/follower/target", target, fix.time_s)


def _pack_track(bag: _Bag, record: TrackRecord) -> None:
    track, time_s = record.track, record.captured_s
    said, values = ("none", {}) if track is None else (str(track.state), track_values(track))
    _pack_status(bag, "/follower/track", _status("track", said, values), time_s, "camera")
    region = _new("sensor_msgs/msg/RegionOfInterest")
    fill_region(region, None if track is None else track.box)
    bag.write("/follower/roi", region, time_s)
    if track is not None:
        detection = bag.new("vision_msgs/msg/Detection2D", time_s, "camera")
        fill_detection(detection, _new("vision_msgs/msg/ObjectHypothesisWithPose"), track)
        bag.write("/follower/detection", detection, time_s)


def _status(name: str, said: str, values: dict[str, float], level: int = _OK) -> Any:
    pair = _T["diagnostic_msgs/msg/KeyValue"]
    pairs = [pair(key, f"{value:.6g}") for key, value in values.items()]
    return _T["diagnostic_msgs/msg/DiagnosticStatus"](level, name, said, "follower", pairs)


def _pack_status(bag: _Bag, topic: str, status: Any, time_s: float, frame_id: str = "") -> None:
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    bag.write(topic, bag.new(kind, time_s, frame_id, status=[status]), time_s)


def unpack(bag: Path, out: Path) -> str:
    """Write the images and the telemetry of a bag; return what to do with them.

    The first topic of images counts, raw or compressed, and all Imu and Odometry messages.

    Raises:
        SourceError: it is no bag, or has no images; or `out` has such files already.
    """
    for file in (out / CLIP, out / TABLE):
        if file.exists():
            raise SourceError(f"{file}: exists already; give another --out")
    with BagImages(bag) as images, VideoWriter(out / CLIP, 30.0) as writer:
        out.mkdir(parents=True, exist_ok=True)
        first_s = images.first_s
        while (frame := images.read()) is not None:
            writer.write(frame.image, frame.captured_s)
    with _opened(bag) as reader:
        first_row_s = _unpack_telemetry(reader, out / TABLE)
    if first_row_s is None:
        return f"follower import {out / CLIP} --target X,Y,W,H"
    offset_s = first_s - first_row_s
    return (
        f"follower import {out / CLIP} --telemetry {out / TABLE} --offset {offset_s:.6f} "
        "--target X,Y,W,H"
    )


@contextmanager
def _errors(bag: Path) -> Iterator[None]:
    """Make one line of what rosbags raises of a broken file, which has many kinds."""
    try:
        yield
    except SourceError:
        raise
    except Exception as error:
        raise SourceError(f"{bag}: cannot be read as a bag: {error}") from error


@contextmanager
def _opened(bag: Path) -> Iterator[AnyReader]:
    with _errors(bag), AnyReader([bag], default_typestore=_STORE) as reader:
        yield reader


class BagImages(ClosesItself):
    """Gives the images of a bag's first topic that has some, raw or compressed.

    Attributes:
        topic: of the images.
        first_s: the first one's stamp, from which `captured_s` counts.
        nominal_rate_hz, frame_count, problem: as of any source.

    Raises:
        SourceError: it is no bag, or has no images.
    """

    problem: str | None = None

    def __init__(self, bag: Path) -> None:
        self._bag = bag
        kinds = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
        with _errors(bag), ExitStack() as stack:
            reader = stack.enter_context(AnyReader([bag], default_typestore=_STORE))
            self._messages = _messages(reader, kinds)
            self._next = next(self._messages, None)
            if self._next is None:
                raise SourceError(f"{bag}: there are no images in this bag")
            self.topic, self.first_s, _ = self._next
            self.frame_count = sum(
                one.msgcount for one in reader.connections if one.topic == self.topic
            )
            self.nominal_rate_hz = self.frame_count / max(reader.duration * 1e-9, 1e-3)
            self._open = stack.pop_all()
        self._newest_s, self._sequence = -math.inf, 0

    def read(self) -> Frame | None:
        """Return the next image, None at the end.

        Raises:
            SourceError: one cannot be decoded, or the bag is broken there.
        """
        while self._next is not None:
            topic, time_s, message = self._next
            with _errors(self._bag):
                image = image_of(message) if topic == self.topic else None
                self._next = next(self._messages, None)
            if image is not None and time_s > self._newest_s:
                self._newest_s, self._sequence = time_s, self._sequence + 1
                return Frame(image, time_s - self.first_s, self._sequence - 1)
        return None

    def close(self) -> None:
        """Close the bag."""
        self._next = None
        self._open.close()


def read_bag(bag: Path) -> TelemetryLog | None:
    """Return a bag's telemetry, None if it has none; time 0 is the first image's stamp.

    That is Imu, Odometry, the mode of MAVROS, and without Odometry a PoseStamped or a NavSatFix;
    the lens by the CameraInfo beside the image.

    Args:
        bag: its folder, or ROS 1's file.

    Raises:
        SourceError: it cannot be read, or has no images.
    """
    with BagImages(bag) as images:
        first_s, beside = images.first_s, images.topic.removesuffix("/compressed")
    with _opened(bag) as reader, TemporaryDirectory() as folder:
        table = Path(folder) / TABLE
        start_s = _unpack_telemetry(reader, table)
        samples = TelemetrySamples() if start_s is None else read_csv(table)
        start_s = first_s if start_s is None else start_s
        if not samples.positions:
            _take_places(samples, reader, start_s)
        info = f"{beside.rpartition('/')[0]}/camera_info"
        told = (vars(m) for topic, _, m in _messages(reader, (_INFO,)) if topic == info)
        first = {name.lower(): one for name, one in next(told, {}).items()}  # ROS 1 has K and D
        samples.lens = lens_of(SimpleNamespace(**first)) if first else {}
    if not samples.attitudes and not samples.places:
        return None
    samples.on_video_clock = True
    return samples.log(str(bag)).moved(start_s - first_s)


def _take_places(samples: TelemetrySamples, reader: AnyReader, start_s: float) -> None:
    """Take the places that nobody gives velocities for, of the first topic that has some."""
    kinds = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/NavSatFix"
    first, ground_m = "", math.nan
    for topic, time_s, message in _messages(reader, kinds):
        first = first or topic
        if topic != first:
            continue
        if hasattr(message, "pose"):
            place = message.pose.position
            samples.places.append((time_s - start_s, place.y, place.x, -place.z))
        elif message.status.status >= 0 and math.isfinite(message.altitude):
            ground_m = ground_m if math.isfinite(ground_m) else message.altitude
            height_m = message.altitude - ground_m
            samples.add_fix(time_s - start_s, message.latitude, message.longitude, height_m)


def _messages(reader: AnyReader, kinds: tuple[str, ...]) -> Iterator[tuple[str, float, Any]]:
    """Give topic, stamp in seconds and message of all messages of these kinds."""
    known = reader.typestore.fielddefs
    wanted = [one for one in reader.connections if one.msgtype in kinds and one.msgtype in known]
    for connection, _, data in reader.messages(connections=wanted) if wanted else ():
        message = reader.deserialize(data, connection.msgtype)
        stamp = message.header.stamp
        yield connection.topic, stamp.sec + stamp.nanosec * 1e-9, message


_ODOMETRY, _STATE = "nav_msgs/msg/Odometry", "mavros_msgs/msg/State"
_INFO = "sensor_msgs/msg/CameraInfo"


def _unpack_telemetry(reader: AnyReader, path: Path) -> float | None:
    """Write the table; return the time of its first row in seconds, None if there is none."""
    rows: list[dict[str, float | str]] = []
    # MAVROS has a second one, /mavros/global_position/local, with another origin.
    odometry = min(
        (one.topic for one in reader.connections if one.msgtype == _ODOMETRY),
        key=lambda topic: ("global" in topic, topic),
        default="",
    )
    for topic, time_s, m in _messages(reader, ("sensor_msgs/msg/Imu", _ODOMETRY, _STATE)):
        row = {TIME: time_s, MODE: m.mode} if hasattr(m, "mode") else _row(time_s, m)
        if row is not None and (topic == odometry or not hasattr(m, "pose")):
            rows.append(row)
    if not rows:
        return None
    if any({RATES[0], ANGLES[0]} <= row.keys() for row in rows):  # the Imu knows attitude better
        rows = [{k: v for k, v in r.items() if RATES[0] in r or k not in ANGLES} for r in rows]
    rows.sort(key=lambda row: float(row[TIME]))
    first_s = float(rows[0][TIME])
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, [TIME, *ANGLES, *RATES, *PLACE, MODE])
        table.writeheader()
        table.writerows({**row, TIME: f"{float(row[TIME]) - first_s:.6f}"} for row in rows)
    return first_s


def _row(time_s: float, m: Any) -> dict[str, float | str] | None:
    """Return a row of an Imu or Odometry message; None of an Odometry without an attitude."""
    pose = getattr(m, "pose", None)
    q = m.orientation if pose is None else pose.pose.orientation
    angles = attitude_of(q)
    row: dict[str, float | str] = {TIME: time_s}
    if pose is None and m.orientation_covariance[0] == -1.0:
        angles = None  # a driver that knows no attitude says so
    elif angles is None:
        return None
    if angles is not None:
        row |= zip(ANGLES, map(math.degrees, angles), strict=True)
    if pose is None:
        turn = m.angular_velocity
        rates = math.degrees(turn.x), -math.degrees(turn.y), -math.degrees(turn.z)
        row |= zip(RATES, rates, strict=True)
    else:
        place, v = pose.pose.position, turned_to_world(q, m.twist.twist.linear)
        row |= zip(PLACE, (place.y, place.x, -place.z, *v), strict=True)
    return row
