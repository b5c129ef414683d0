"""Between ROS's frames, units and images and ours.

ROS has east, north, up and a body of forward, left, up (REP 103); we have north, east, down and
forward, right, down.
"""

import math
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from pymavlink.quaternion import QuaternionBase

from follower.settings.settings import CameraSettings, Settings
from follower_control.servo.position_fix import TargetPosition
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import roll_pitch_yaw, wrap_angle
from follower_vision.images.frame import Image
from follower_vision.trackers.track import Track

Triple = tuple[float, float, float]

_TO_BGR = {
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, cv2.COLOR_GRAY2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUYV),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUYV),
}
"""Bytes of a pixel, and OpenCV's code, by sensor_msgs' name of an encoding."""
TARGET_FRAME = "follower_target"
_NED_TO_ENU = (1, 0, 2)
_SIGNS = (1.0, 1.0, -1.0)
_SQUARE = 0.02
"""By what share focal lengths across and down may differ: our pixels are square."""


def stamp_s(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def set_stamp(stamp: Any, time_s: float) -> None:
    """Set a builtin_interfaces/Time to a time in seconds."""
    whole = math.floor(time_s)
    stamp.sec, stamp.nanosec = whole, min(round((time_s - whole) * 1e9), 999_999_999)


def image_of(message: Any) -> Image:
    """Return the picture of a sensor_msgs/Image or CompressedImage; a raw one is not copied.

    Raises:
        ValueError: its encoding is unknown, or its size does not fit its data.
    """
    try:
        return _image_of(message)
    except cv2.error as error:
        raise ValueError(f"an image that OpenCV cannot read ({error.err})") from error


def _image_of(message: Any) -> Image:
    if hasattr(message, "format"):
        decoded = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        if decoded is None:
            raise ValueError(f"a compressed image ({message.format}) that cannot be decoded")
        return np.asarray(decoded, np.uint8)
    if message.encoding not in _TO_BGR:
        known = ", ".join(_TO_BGR)
        raise ValueError(f"images are {message.encoding!r}: have the camera send one of {known}")
    depth, code = _TO_BGR[message.encoding]
    height, width, step = message.height, message.width, message.step
    if not 0 < width * depth <= step or height < 1 or len(message.data) < step * height:
        raise ValueError(f"an image of {width}x{height} with a step of {step} and too little data")
    rows = np.frombuffer(message.data, np.uint8, step * height).reshape(height, step)
    pixels = rows[:, : width * depth].reshape(height, width, depth)
    return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code), np.uint8)


def fill_image(message: Any, image: Image) -> None:
    """Put a picture into a sensor_msgs/Image."""
    message.height, message.width = image.shape[:2]
    message.encoding, message.step = "bgr8", 3 * image.shape[1]
    # Item by item rclpy would check each byte; of this type it takes all at once.
    data = type(message.data)("B")
    data.frombytes(np.ascontiguousarray(image).data.cast("B"))
    message.data = data


def attitude_of(q: Any) -> Triple | None:
    """Return roll, pitch, yaw (NED to forward, right, down) of a pose's quaternion in radians.

    None if it is no rotation.
    """
    size = math.sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
    if not 0.9 < size < 1.1:
        return None
    roll, pitch, yaw = roll_pitch_yaw(q.w / size, q.x / size, q.y / size, q.z / size)
    return roll, -pitch, wrap_angle(math.pi / 2 - yaw)


def fill_attitude(q: Any, attitude_rad: Triple) -> None:
    """Set a pose's quaternion to roll, pitch, yaw (NED to forward, right, down) in radians."""
    roll, pitch, yaw = attitude_rad
    q.w, q.x, q.y, q.z = QuaternionBase([roll, -pitch, math.pi / 2 - yaw]).q.tolist()


def fill_turn(q: Any, turn: tuple[float, float, float, float]) -> None:
    """Set a quaternion to x, y, z, w of a turn, whose result is east, north, up instead of NED."""
    half, (x, y, z, w) = math.sqrt(0.5), turn
    q.w, q.x, q.y, q.z = -half * (x + y), half * (w + z), half * (w - z), half * (y - x)


def turned_to_world(q: Any, v: Any) -> Triple:
    """Return a vector of the body (forward, left, up) as north, east, down."""
    w, x, y, z = q.w, q.x, q.y, q.z
    east = (1 - 2 * (y * y + z * z)) * v.x + 2 * (x * y - w * z) * v.y + 2 * (x * z + w * y) * v.z
    north = 2 * (x * y + w * z) * v.x + (1 - 2 * (x * x + z * z)) * v.y + 2 * (y * z - w * x) * v.z
    up = 2 * (x * z - w * y) * v.x + 2 * (y * z + w * x) * v.y + (1 - 2 * (x * x + y * y)) * v.z
    return north, east, -up


def turned_to_body(q: Any, north_east_down: Triple) -> Triple:
    """Return a vector of the world as forward, left, up of a body: `turned_to_world` back."""
    units = {"x": 0.0, "y": 0.0, "z": 0.0}
    axes = [turned_to_world(q, SimpleNamespace(**{**units, one: 1.0})) for one in units]
    f, le, u = (sum(a * b for a, b in zip(axis, north_east_down, strict=True)) for axis in axes)
    return f, le, u


def fill_vector(v: Any, x: float, y: float, z: float) -> None:
    """Set a Vector3 or Point."""
    v.x, v.y, v.z = float(x), float(y), float(z)


def fill_twist(twist: Any, setpoint: VelocitySetpoint) -> None:
    """Put a setpoint into a Twist: forward, left, up in m/s, and counter-clockwise rad/s."""
    forward, right, down, yaw_rate = setpoint.values
    fill_vector(twist.linear, forward, -right, -down)
    twist.angular.z = -float(yaw_rate)


def fill_region(region: Any, box: Box | None) -> None:
    """Put a box into a RegionOfInterest, whose pixels are whole; all zeros for none."""
    if box is not None:
        left, top = max(round(box.left), 0), max(round(box.top), 0)
        region.x_offset, region.y_offset = left, top
        region.width = max(round(box.right) - left, 0)
        region.height = max(round(box.bottom) - top, 0)


def fill_detection(detection: Any, result: Any, track: Track) -> None:
    """Put a track into a vision_msgs/Detection2D, by an ObjectHypothesisWithPose of its state."""
    place = detection.bbox.center.position
    place.x, place.y = float(track.box.cx), float(track.box.cy)
    detection.bbox.size_x, detection.bbox.size_y = map(float, track.box.xywh[2:])
    result.hypothesis.class_id = str(track.state)
    result.hypothesis.score = float(track.confidence)
    detection.results = [result]


def track_values(track: Track) -> dict[str, float]:
    """Return what the topic `track` tells in numbers."""
    box = dict(zip(("x", "y", "width", "height"), track.box.xywh, strict=True))
    return {**box, "probability": track.confidence}


def fill_fix(pose: Any, fix: TargetPosition) -> None:
    """Put the target's place into a PoseWithCovariance."""
    north, east, down = fix.position_m
    fill_vector(pose.pose.position, east, north, -down)
    pose.pose.orientation.w = 1.0
    for row, (of, sign) in enumerate(zip(_NED_TO_ENU, _SIGNS, strict=True)):
        for column, (to, other) in enumerate(zip(_NED_TO_ENU, _SIGNS, strict=True)):
            pose.covariance[6 * row + column] = sign * other * float(fix.covariance[of, to])


def fill_info(info: Any, model: CameraModel) -> None:
    """Put a lens into a CameraInfo, all but the distortion: it is made with `d`."""
    info.width, info.height, info.distortion_model = model.width, model.height, "plumb_bob"
    # ROS counts from the middle of the first pixel, we from its corner.
    rows = (model.fx, 0.0, model.cx - 0.5), (0.0, model.fy, model.cy - 0.5), (0.0, 0.0, 1.0)
    for n, row in enumerate(rows):
        info.k[3 * n : 3 * n + 3] = info.p[4 * n : 4 * n + 3] = row
        info.r[4 * n] = 1.0


def lens_of(info: Any) -> dict[str, Any]:
    """Return what a calibrated sensor_msgs/CameraInfo sets in `CameraSettings`; else nothing.

    Nothing either of a lens that our model does not fit: its lines of sight would be wrong unseen.
    """
    fx, fy, cx, cy = info.k[0], info.k[4], info.k[2], info.k[5]
    if not (math.isfinite(fx + fy + cx + cy) and fx > 0 and info.width > 0):
        return {}
    whole = info.roi.width in (0, info.width) and info.roi.height in (0, info.height)
    if not whole or abs(fy - fx) > _SQUARE * fx:
        return {}
    given = tuple(map(float, [*info.d, 0.0, 0.0, 0.0, 0.0, 0.0][:5]))
    plain = info.distortion_model in ("plumb_bob", "rational_polynomial", "")
    if not plain or any(info.d[5:]) or not all(map(math.isfinite, given)):
        return {}
    lens: dict[str, Any] = {
        "focal_px": float(fx),
        "focal_width_px": int(info.width),
        "center_px": (float(cx) + 0.5, float(cy) + 0.5),
        "distortion": given,
    }
    try:
        CameraSettings(**lens)
    except ValueError:
        return {}
    return lens


def flat_settings(settings: Settings) -> dict[str, Any]:
    """Return all settings by their paths, as values that a ROS parameter can have.

    None is the text "null"; a list of anything but numbers, or an empty one, is its text.
    """
    found: dict[str, Any] = {}
    waiting: list[tuple[str, Any]] = [("", settings.model_dump(mode="json"))]
    while waiting:
        prefix, value = waiting.pop()
        if isinstance(value, dict) and value:
            named = ((f"{prefix}.{key}".lstrip("."), one) for key, one in value.items())
            waiting += reversed(list(named))
        elif value is None:
            found[prefix] = "null"
        elif isinstance(value, list | dict):
            numbers = isinstance(value, list) and value and all(type(x) is float for x in value)
            found[prefix] = value if numbers else str(value)
        else:
            found[prefix] = value
    return found
