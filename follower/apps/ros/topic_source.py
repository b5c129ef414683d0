"""A topic of images as a live source of frames."""

from dataclasses import dataclass, field
from typing import Any

from sensor_msgs.msg import CompressedImage, Image

from follower.apps.ros.conversion import image_of, stamp_s
from follower.apps.ros.io_node import NEWEST, IoNode, RosClock
from follower.apps.video_input import VideoInput
from follower_vision.clock import Clock
from follower_vision.images.frame import Frame
from follower_vision.mailbox import Mailbox
from follower_vision.sources.frame_source import ClosesItself, FrameSource

_RATE_HZ = 30.0


class TopicSource(ClosesItself):
    """The newest image of a topic, on a node and a thread of its own; see `FrameSource`.

    A frame is of the time of its header's stamp. Images whose stamp lies in the future, is older
    than 5 s, or not newer than the one before are left out: they count as missing.

    Args:
        owner: the lifecycle node.
        topic: as the user names it.
        transport: "raw", or "compressed" by image_transport's name.
        clock: by which frames are stamped, the flight's; None makes one.

    Attributes:
        clock: the same.
        problem: why there is no new frame; None while there are.
        frame_id: of the newest image.
    """

    frame_count: int | None = None
    nominal_rate_hz = _RATE_HZ

    def __init__(
        self, owner: Any, topic: str, transport: str, clock: RosClock | None = None
    ) -> None:
        compressed = transport == "compressed"
        self._io = IoNode(f"{owner.get_name()}_camera", owner)
        self.clock = clock or self._io.clock
        name = self._io.name_of(f"{topic}/compressed") if compressed else self._io.name_of(topic)
        if compressed and name == owner.resolve_topic_name(f"{topic}/compressed", only_expand=True):
            name = f"{self._io.name_of(topic)}/compressed"  # as its base was remapped
        self.problem: str | None = f"no image has come on {name}"
        self.frame_id = ""
        self._mailbox: Mailbox[Frame] = Mailbox()
        self._sequence, self._newest_s = 0, float("-inf")
        kind = CompressedImage if compressed else Image
        self._io.subscribe(kind, name, self._take, NEWEST)
        self._io.start()

    def read(self) -> Frame | None:
        """Return the newest frame not read yet, waiting for it; None once closed."""
        return self._mailbox.wait()

    def close(self) -> None:
        """Stop; who waits in `read` gets None."""
        if not self._mailbox.closed:
            self._mailbox.close()
            self._io.close()

    def _take(self, message: Any) -> None:
        stamped_s = stamp_s(message.header.stamp)
        captured_s = self.clock.of_stamp(stamped_s)
        if captured_s is None:
            age_s = self.clock.ros_s() - stamped_s
            self.problem = f"images are stamped {age_s:.1f} s ago: set the clocks, or use_sim_time"
            return
        if stamped_s <= self._newest_s:
            self.problem = "images are stamped no later than the ones before"
            return
        try:
            image = image_of(message)
        except ValueError as error:
            self.problem = str(error)
            return
        self._newest_s, self.problem = stamped_s, None
        self.frame_id = message.header.frame_id
        self._mailbox.put(Frame(image, captured_s, self._sequence))
        self._sequence += 1


@dataclass(frozen=True, slots=True)
class TopicInput(VideoInput):
    """A topic as a flight's camera.

    Attributes:
        source: is open already; the flight closes it.
    """

    source: TopicSource = field(kw_only=True)

    @property
    def is_live(self) -> bool:
        """It is."""
        return True

    def open(self, _clock: Clock | None = None) -> FrameSource:
        """Return the source, which has its clock already."""
        return self.source
