"""A recorded flight for Foxglove: its messages, and pictures, boxes and a scene as foxglove.*."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import foxglove
from foxglove import channels
from foxglove import messages as fox

from follower.apps.viewers.scene import COLOURS, FlightScene, Point, Pose, Quaternion, emptied
from follower.flight.log import ControlRecord, TrackRecord
from follower.recording import RecordedFlight
from follower.recording.codec import encode, json_schema, schema_name
from follower.recording.messages import MESSAGES
from follower_vision.trackers.track import Track

IMAGE, BOXES, CALIBRATION = "/camera/image", "/camera/boxes", "/camera/calibration"
TRANSFORMS, AXES, FIX = "/tf", "/tf_static", "/vehicle/fix"
SCENE, PATHS = "/scene", "/scene/paths"
"""What is written once has topics of its own: a viewer that jumps in time shows each topic's newest
message, not what is left of older ones."""
WORLD, NED, BODY, CAMERA = "world", "ned", "body", "camera"
"""Frames: east, north, up; north, east, down; forward, right, down; right, down, forward."""
VEHICLE = "vehicle"
"""Frame at the body, but east, north, up: a view that follows a frame has its z axis upwards."""
_UP = math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0
"""From north, east, down to east, north, up, or back: x, y, z, w."""
_TARGET = "target"
_USUAL_WIDTH = 640
"""Lines and letters are in pixels of the picture, which is shown as wide as the panel."""


def write_foxglove(recorded: RecordedFlight, out: Path) -> Path:
    """Write the file, over one that is there, and return its path.

    Raises:
        FlightFileError: the flight's settings are not understood.
        OSError: the file cannot be written.
    """
    scene, context = FlightScene(recorded), foxglove.Context()
    with (
        emptied(out, recorded),
        foxglove.open_mcap(str(out), allow_overwrite=True, context=context),
    ):
        writer = _Writer(context, recorded)
        writer.messages(recorded)
        writer.pictures(scene)
        for track in recorded.log.tracks:
            writer.boxes(track)
        controls = recorded.log.controls
        if controls:
            writer.begin(scene, controls[0].time_s)
        for record in controls:
            writer.poses(scene, record)
        for record in controls[::5]:
            writer.target(scene, record)
            writer.fix(record)
    return out


class _Writer:
    """Puts things into an open file; times in seconds on the flight's clock."""

    def __init__(self, context: foxglove.Context, recorded: RecordedFlight) -> None:
        self._context, self._epoch_ns = context, recorded.config.epoch_ns
        self._scale = recorded.frames[0].width / _USUAL_WIDTH if recorded.frames else 1.0
        self._image = channels.CompressedImageChannel(IMAGE, context=context)
        self._boxes = channels.ImageAnnotationsChannel(BOXES, context=context)
        self._calibration = channels.CameraCalibrationChannel(CALIBRATION, context=context)
        self._transforms = channels.FrameTransformsChannel(TRANSFORMS, context=context)
        self._axes = channels.FrameTransformsChannel(AXES, context=context)
        self._scene = channels.SceneUpdateChannel(SCENE, context=context)
        self._paths = channels.SceneUpdateChannel(PATHS, context=context)
        self._fix = channels.LocationFixChannel(FIX, context=context)

    def messages(self, recorded: RecordedFlight) -> None:
        """Write the flight's own messages, as they are in its log."""
        logs: dict[type, Callable[..., None]] = {}
        for kind in MESSAGES:
            data = json.dumps(json_schema(kind)).encode()
            schema = foxglove.Schema(name=schema_name(kind), encoding="jsonschema", data=data)
            context = self._context
            logs[kind.record] = foxglove.Channel(
                kind.topic, schema=schema, message_encoding="json", context=context
            ).log
        for time_s, message in recorded.messages():
            logs[type(message)](encode(message), log_time=self._ns(time_s))

    def pictures(self, scene: FlightScene) -> None:
        """Write the pictures of the video."""
        for time_s, data in scene.pictures():
            stamp = self._stamp(time_s)
            image = fox.CompressedImage(timestamp=stamp, frame_id=CAMERA, data=data, format="jpeg")
            self._image.log(image, log_time=self._ns(time_s))

    def boxes(self, record: TrackRecord) -> None:
        """Write the box of a frame, or that there is none."""
        stamp, track = self._stamp(record.captured_s), record.track
        points = [] if track is None else [_outline(track, stamp, self._scale)]
        texts = [] if track is None else [_label(track, stamp, self._scale)]
        annotations = fox.ImageAnnotations(timestamp=stamp, points=points, texts=texts)
        self._boxes.log(annotations, log_time=self._ns(record.captured_s))

    def begin(self, scene: FlightScene, time_s: float) -> None:
        """Write what stays as it is: axes, lens, paths."""
        stamp, now_ns = self._stamp(time_s), self._ns(time_s)
        up = fox.FrameTransform(
            timestamp=stamp, parent_frame_id=WORLD, child_frame_id=NED, rotation=_rotation(_UP)
        )
        self._axes.log(fox.FrameTransforms(transforms=[up]), log_time=now_ns)
        lines = {"path": (scene.path(), "tracking"), "true path": (scene.true_path(), "coasting")}
        entities = [
            _entity(name, stamp, lines=[_line(points, colour)])
            for name, (points, colour) in lines.items()
            if len(points) > 1
        ]
        self._paths.log(fox.SceneUpdate(entities=entities), log_time=now_ns)
        lens = scene.camera
        if lens is not None:
            K = lens.matrix.ravel().tolist()
            calibration = fox.CameraCalibration(
                timestamp=stamp,
                frame_id=CAMERA,
                width=lens.width,
                height=lens.height,
                distortion_model="plumb_bob",
                D=list(lens.distortion),
                K=K,
                R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
                P=[*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0],
            )
            self._calibration.log(calibration, log_time=now_ns)

    def poses(self, scene: FlightScene, record: ControlRecord) -> None:
        """Write where the vehicle and its camera are."""
        stamp = self._stamp(record.time_s)
        body = scene.body(record)
        level = None if body is None else Pose(body.position_m, _UP)
        known = ((VEHICLE, level), (BODY, body), (CAMERA, scene.eye(record)))
        found = [_transform(name, pose, stamp) for name, pose in known if pose is not None]
        if found:
            transforms = fox.FrameTransforms(transforms=found)
            self._transforms.log(transforms, log_time=self._ns(record.time_s))

    def target(self, scene: FlightScene, record: ControlRecord) -> None:
        """Write where the target is by the estimate, or that nobody knows."""
        stamp, place, body = self._stamp(record.time_s), scene.target(record), scene.body(record)
        if place is None or body is None:
            gone = fox.SceneEntityDeletion(timestamp=stamp, id=_TARGET)
            update = fox.SceneUpdate(deletions=[gone])
        else:
            pose = fox.Pose(position=_vector(place), orientation=fox.Quaternion(w=1.0))
            size = fox.Vector3(x=1.0, y=1.0, z=1.0)
            ball = fox.SpherePrimitive(pose=pose, size=size, color=_colour("lost"))
            sight = _line([body.position_m, place], "lost")
            update = fox.SceneUpdate(
                entities=[_entity(_TARGET, stamp, spheres=[ball], lines=[sight])]
            )
        self._scene.log(update, log_time=self._ns(record.time_s))

    def fix(self, record: ControlRecord) -> None:
        """Write the vehicle's latitude and longitude, if its origin is known."""
        origin, position = record.vehicle.origin, record.vehicle.position
        if origin is None or position is None:
            return
        latitude_deg, longitude_deg = origin.geolocated(position.north_m, position.east_m)
        fix = fox.LocationFix(
            timestamp=self._stamp(record.time_s),
            frame_id=BODY,
            latitude=latitude_deg,
            longitude=longitude_deg,
            altitude=position.height_m,
        )
        self._fix.log(fix, log_time=self._ns(record.time_s))

    def _ns(self, time_s: float) -> int:
        return max(0, self._epoch_ns + round(time_s * 1e9))

    def _stamp(self, time_s: float) -> fox.Timestamp:
        return fox.Timestamp(*divmod(self._ns(time_s), 10**9))


def _outline(track: Track, stamp: fox.Timestamp, scale: float) -> fox.PointsAnnotation:
    box = track.box
    corners = [(box.left, box.top), (box.right, box.top), (box.right, box.bottom)]
    return fox.PointsAnnotation(
        timestamp=stamp,
        type=fox.PointsAnnotationType.LineLoop,
        points=[fox.Point2(x=x, y=y) for x, y in (*corners, (box.left, box.bottom))],
        outline_color=_colour(track.state),
        thickness=2.0 * scale,
    )


def _label(track: Track, stamp: fox.Timestamp, scale: float) -> fox.TextAnnotation:
    return fox.TextAnnotation(
        timestamp=stamp,
        position=fox.Point2(x=track.box.left, y=track.box.top - 4 * scale),
        text=f"{track.state} {track.confidence:.2f} {track.produced_by}",
        font_size=12.0 * scale,
        text_color=_colour(track.state),
    )


def _transform(name: str, pose: Pose, stamp: fox.Timestamp) -> fox.FrameTransform:
    return fox.FrameTransform(
        timestamp=stamp,
        parent_frame_id=NED,
        child_frame_id=name,
        translation=_vector(pose.position_m),
        rotation=_rotation(pose.turn),
    )


def _rotation(turn: Quaternion) -> fox.Quaternion:
    x, y, z, w = turn
    return fox.Quaternion(x=x, y=y, z=z, w=w)


def _entity(name: str, stamp: fox.Timestamp, **primitives: Any) -> fox.SceneEntity:
    return fox.SceneEntity(timestamp=stamp, frame_id=NED, id=name, **primitives)


def _line(points: list[Point], colour: str) -> fox.LinePrimitive:
    return fox.LinePrimitive(
        type=fox.LinePrimitiveLineType.LineStrip,
        pose=fox.Pose(position=_vector((0.0, 0.0, 0.0)), orientation=fox.Quaternion(w=1.0)),
        thickness=2.0,
        scale_invariant=True,
        points=[fox.Point3(x=x, y=y, z=z) for x, y, z in points],
        color=_colour(colour),
    )


def _vector(point: Point) -> fox.Vector3:
    x, y, z = point
    return fox.Vector3(x=x, y=y, z=z)


def _colour(state: str) -> fox.Color:
    red, green, blue = (value / 255 for value in COLOURS[state])
    return fox.Color(r=red, g=green, b=blue, a=1.0)
