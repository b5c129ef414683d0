"""What a flight shows as topics: track, target, setpoint, overlay image, diagnostics."""

import threading
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, TwistStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, RegionOfInterest

from follower.apps.ros.conversion import (
    fill_detection,
    fill_fix,
    fill_image,
    fill_region,
    fill_twist,
    fill_vector,
    set_stamp,
    track_values,
)
from follower.apps.ros.io_node import RELIABLE, RosClock
from follower.apps.ros.vehicle_topics import VehicleTopics
from follower.flight.log import ControlRecord, LogRecord, TrackRecord
from follower.flight.status import LiveStatus
from follower.flight.supervision.supervisor import SupervisorReason as Reason
from follower.settings.settings import Settings
from follower_control.servo.position_fix import TargetPosition, target_fix
from follower_vision.drawing.overlay import draw_tracks
from follower_vision.images.frame import Frame
from follower_vision.mailbox import Mailbox
from follower_vision.trackers.track import Track

_AS_USUAL = (
    "",
    Reason.NO_TARGET,
    Reason.NOT_FLYING,
    Reason.WAITING_FOR_PILOT,
    Reason.WAITING_FOR_CONSENT,
    Reason.TARGET_SEEN,
    Reason.TARGET_UNSEEN,
)
"""All else is a warning of the diagnostics."""


class Outputs:
    """Publishes what a flight decides, on the threads on which it does; the overlay on its own.

    Topics below the node's name: `track` (diagnostic_msgs/DiagnosticArray with box, state and
    probability), `roi` (sensor_msgs/RegionOfInterest), `detection` (vision_msgs/Detection2D, where
    it is installed), `target` (geometry_msgs/PoseWithCovarianceStamped), `setpoint`
    (geometry_msgs/TwistStamped: what was sent), `overlay` (sensor_msgs/Image, while somebody looks)
    and /diagnostics; the target's place also on /tf, where tf2_msgs is installed.
    """

    def __init__(self, node: Any) -> None:
        self.clock: RosClock | None = None
        self._now = node.get_clock().now
        self.settings = Settings()
        self.image_frame = ""
        self.vehicle: VehicleTopics | None = None
        make = node.create_publisher
        self._track = make(DiagnosticArray, "~/track", RELIABLE)
        self._region = make(RegionOfInterest, "~/roi", RELIABLE)
        self._target = make(PoseWithCovarianceStamped, "~/target", RELIABLE)
        self._setpoint = make(TwistStamped, "~/setpoint", RELIABLE)
        self._overlay = make(Image, "~/overlay", QoSProfile(depth=1))
        self._diagnostics = make(DiagnosticArray, "/diagnostics", RELIABLE)
        self._detection, self._tf = _optional(node)
        self._name = node.get_fully_qualified_name()
        # Frames of all vehicles are in one tree.
        self._target_frame = f"{self._name.lstrip('/')}_target"
        self._pictures: Mailbox[tuple[Frame, Sequence[Track], Sequence[str]]] = Mailbox()
        self._drawer = threading.Thread(target=self._draw, name="overlay", daemon=True)
        self._drawer.start()

    def close(self) -> None:
        """Publish no more."""
        self._pictures.close()
        self._drawer.join()

    def show(self, record: LogRecord) -> None:
        """Publish a record, if it is one that has a topic."""
        if isinstance(record, TrackRecord):
            self._show_track(record)
        elif isinstance(record, ControlRecord):
            self._show_control(record)

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Have a frame drawn and published, if anybody looks; see `FlightVideo`."""
        if self._overlay.get_subscription_count():
            self._pictures.put((frame, tuple(tracks), tuple(lines)))

    def diagnose(self, status: LiveStatus | None, problem: str, mode: str) -> None:
        """Publish how the flight is; `status` is None while there is none."""
        state = DiagnosticStatus(name=f"{self._name}: supervisor", hardware_id=mode)
        state.level, state.message = DiagnosticStatus.OK, "inactive"
        if status is not None:
            state.message = f"{status.state}: {status.reason}"
            if status.reason not in _AS_USUAL or status.track == "lost":
                state.level = DiagnosticStatus.WARN
            shown = {
                "waiting for": status.phase,
                "track": status.track,
                "confidence": status.confidence,
                "range m": status.range_m,
                "frames per second": status.frame_rate_hz,
                "vision s": status.vision_s,
                "control late s": status.late_s,
                "link": status.link,
            }
            state.values = _pairs(shown)
        if problem:
            state.level = DiagnosticStatus.ERROR
            state.message = problem
        array = DiagnosticArray(status=[state])
        self._stamp(array.header, None)
        self._diagnostics.publish(array)

    def _stamp(self, header: Any, time_s: float | None, frame_id: str = "") -> None:
        """Stamp a header with a time on the flight's clock, now if None."""
        header.frame_id = frame_id
        if self.clock is None:
            header.stamp = self._now().to_msg()
        else:
            back_s = 0.0 if time_s is None else self.clock.now() - time_s
            set_stamp(header.stamp, max(self.clock.ros_s() - back_s, 0.0))

    def _show_track(self, record: TrackRecord) -> None:
        track = record.track
        status = DiagnosticStatus(name="track", hardware_id=self._name)
        status.message = "none" if track is None else str(track.state)
        region = RegionOfInterest()
        fill_region(region, None if track is None else track.box)
        if track is not None:
            status.values = _pairs(track_values(track))
        array = DiagnosticArray(status=[status])
        self._stamp(array.header, record.captured_s, self.image_frame)
        self._track.publish(array)
        self._region.publish(region)
        if self._detection is not None and track is not None:
            kind, hypothesis, publisher = self._detection
            message = kind(header=array.header)
            fill_detection(message, hypothesis(), track)
            publisher.publish(message)

    def _show_control(self, record: ControlRecord) -> None:
        if record.sent:
            message = TwistStamped()
            frame = "base_link" if self.vehicle is None else self.vehicle.body_frame
            self._stamp(message.header, record.time_s, frame)
            fill_twist(message.twist, record.allowed)
            self._setpoint.publish(message)
        if record.estimate is not None:
            fix = target_fix(record.estimate, record.vehicle, self.settings.servo)
            if fix is not None:
                self._show_target(fix)

    def _show_target(self, fix: TargetPosition) -> None:
        message = PoseWithCovarianceStamped()
        frame = "map" if self.vehicle is None else self.vehicle.frame_id
        self._stamp(message.header, fix.time_s, frame)
        fill_fix(message.pose, fix)
        self._target.publish(message)
        if self._tf is not None:
            kind, publisher = self._tf
            transform = TransformStamped(header=message.header, child_frame_id=self._target_frame)
            place = message.pose.pose.position
            fill_vector(transform.transform.translation, place.x, place.y, place.z)
            publisher.publish(kind(transforms=[transform]))

    def _draw(self) -> None:
        while not self._pictures.closed:
            taken = self._pictures.wait()
            if taken is not None:
                frame, tracks, lines = taken
                message = Image()
                self._stamp(message.header, frame.captured_s, self.image_frame)
                fill_image(message, draw_tracks(frame.image, tracks, lines))
                self._overlay.publish(message)


def _optional(node: Any) -> tuple[tuple[type, type, Any] | None, tuple[type, Any] | None]:
    """Return publishers of messages that not everybody has installed."""
    detection = tf = None
    try:
        from vision_msgs.msg import Detection2D, ObjectHypothesisWithPose

        publisher = node.create_publisher(Detection2D, "~/detection", RELIABLE)
        detection = Detection2D, ObjectHypothesisWithPose, publisher
    except ImportError:
        pass
    try:
        from tf2_msgs.msg import TFMessage

        tf = TFMessage, node.create_publisher(TFMessage, "/tf", RELIABLE)
    except ImportError:
        pass
    return detection, tf


def _pairs(values: Mapping[str, object]) -> list[KeyValue]:
    shown = {key: f"{v:.4g}" if isinstance(v, float) else str(v) for key, v in values.items()}
    return [KeyValue(key=key, value=text) for key, text in shown.items() if text != "None"]
