"""The flight of the Python API between topics: a picture in, setpoints and tracks out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from follower.apps.api.pursuit import Pursuit
from follower.apps.fly.flight import RealFlight
from follower.apps.fly.opened import OpenedFlight
from follower.apps.preflight.camera_checks import CAMERA
from follower.apps.preflight.checklist import CHECKS
from follower.apps.ros.detections import TopicDetector
from follower.apps.ros.io_node import RosClock
from follower.apps.ros.topic_source import TopicInput, TopicSource
from follower.flight.log import FlightSink, LogRecord
from follower.flight.vision.video_sink import FlightVideo
from follower.links.connections import open_connection
from follower.settings.settings import Settings
from follower_control.common.transport import Transport
from follower_vision.clock import MonotonicClock
from follower_vision.detection import Detector
from follower_vision.images.frame import Frame
from follower_vision.trackers.target_tracker import TargetTracker

OnRecord: TypeAlias = Callable[[LogRecord], None]
_PERCEPTION_CHECK_S = 3.5
PERCEPTION_SKIPS = tuple(one.name for one in CHECKS if one not in CAMERA.checks)
"""Checks of a vehicle and of a recording's disk: others fly."""


@dataclass(frozen=True, slots=True)
class TopicEnds:
    """What a flight between topics is connected to.

    Attributes:
        source: the camera, open.
        clock: of all times.
        transport: to the vehicle's topics; None speaks MAVLink at `connect`.
        detector: another node's, if there is one.
        on_record: is shown each record as it is made, on the thread that makes it.
        video: is shown every frame with its track, likewise.
    """

    source: TopicSource
    clock: RosClock
    transport: Transport | None
    detector: TopicDetector | None
    on_record: OnRecord
    video: FlightVideo


class TopicPursuit(Pursuit):
    """A `Pursuit` whose camera, and vehicle if it is not reached directly, are topics.

    Args:
        ends: what it is connected to.
        topic: of the images, for the recording.
        steers: it may; else nobody asks whether a vehicle is ready.
        kept: arguments of `Pursuit`.
    """

    def __init__(
        self, ends: TopicEnds, connect: str, topic: str, *, steers: bool, **kept: Any
    ) -> None:
        self._ends = ends
        super().__init__(connect, camera=topic, **kept)
        checks = self._plan.checks
        if not steers:
            checks = replace(checks, longest_s=_PERCEPTION_CHECK_S)
        camera = TopicInput(topic, realtime=True, source=ends.source)
        detector = "" if ends.detector is None else f"ros:{ends.detector.topic}"
        self._plan = replace(self._plan, camera=camera, checks=checks, detector=detector)

    @property
    def flight(self) -> RealFlight:
        """The flight, while the block runs."""
        return self._flight

    @property
    def settings(self) -> Settings:
        """Those that it begins with."""
        return self._plan.settings

    @property
    def flying(self) -> bool:
        """Whether it goes on; it ends early where something failed."""
        return self._flying

    def _make_detector(self) -> Detector | None:
        return self._ends.detector or super()._make_detector()

    def _make_clock(self) -> MonotonicClock:
        return self._ends.clock

    def _open_transport(self) -> Transport:
        return self._ends.transport or open_connection(self._plan.connect)

    def _wire(self, opened: OpenedFlight, tracker: TargetTracker) -> RealFlight:
        log = opened.recorder.log
        if log.sink is not None:
            log.sink = _ShownSink(log.sink, self._ends.on_record)
        return opened.ready(tracker, video=self._ends.video)


class _ShownSink:
    """A recorder's sink that shows what it takes."""

    def __init__(self, sink: FlightSink, show: OnRecord) -> None:
        self._sink, self._show = sink, show

    def add_frame(self, frame: Frame, received_s: float) -> None:
        self._sink.add_frame(frame, received_s)

    def add(self, record: LogRecord, time_s: float) -> None:
        self._show(record)
        self._sink.add(record, time_s)
