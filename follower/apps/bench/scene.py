"""The flight that a bench is flown on: a car on a winding road, rendered once, cut to each size."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from follower.flight.log import TrackRecord
from follower.settings.settings import find_scenario
from follower_sim.camera import SimCamera
from follower_sim.chaser import Chaser
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.world import World
from follower_vision.clock import Clock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.sources.frame_source import ClosesItself

Size = tuple[int, int]
"""Width and height in pixels."""

_SCENARIO, _STARTS_S = "winding", 18.0
_QUALITY = 90


@dataclass(frozen=True, slots=True)
class BenchClip:
    """A short film of a target, which is played forwards and backwards without end.

    Attributes:
        size: of its pictures.
        pictures: JPEG files, as USB cameras send them.
        boxes: the target's true box in each.
    """

    size: Size
    pictures: tuple[bytes, ...]
    boxes: tuple[Box, ...]

    def index(self, sequence: int) -> int:
        """Return which picture a frame shows."""
        last = len(self.pictures) - 1
        turn = sequence % (2 * last)
        return min(turn, 2 * last - turn)

    def decoded(self, index: int) -> Image:
        """Return a picture."""
        coded = np.frombuffer(self.pictures[index], np.uint8)
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)


def render_clips(
    sizes: Sequence[Size], count: int, go_on: Callable[[], bool] = lambda: True
) -> dict[Size, BenchClip] | None:
    """Render the flight once, at the largest size, and cut the others out of it.

    Args:
        sizes: wanted.
        count: of pictures, at least 2.
        go_on: is asked after each picture.

    Returns:
        A clip for each size; None once `go_on` said no.
    """
    scenario = load_scenario(find_scenario(_SCENARIO))
    largest = max(sizes, key=lambda size: size[0] * size[1])
    lens = {"width": largest[0], "height": largest[1], "drop_probability": 0.0}
    camera = scenario.camera.model_copy(update=lens)
    world = World(scenario.model_copy(update={"camera": camera}))
    chaser, truth = Chaser(world), GroundTruth(world)
    source = SimCamera(world, chaser)
    films: dict[Size, list[tuple[bytes, Box]]] = {size: [] for size in sizes}
    for number in range(count):
        time_s = source.next_capture_s = _STARTS_S + number / source.rate_hz
        delivery, box = source.capture(), truth.seen(time_s, chaser(time_s)).box
        if delivery is None or box is None:
            raise RuntimeError(f"{_SCENARIO} shows no target at {time_s:.2f} s")
        for size, film in films.items():
            film.append(_cut(delivery.frame.image, box, size))
        if not go_on():
            return None
    return {size: BenchClip(size, *zip(*film, strict=True)) for size, film in films.items()}


def _cut(image: Image, box: Box, size: Size) -> tuple[bytes, Box]:
    """Return the middle of a picture at another size, as JPEG, and the box in it."""
    (height, width), (to_width, to_height) = image.shape[:2], size
    scale = max(to_width / width, to_height / height)
    across, down = round(to_width / scale), round(to_height / scale)
    left, top = (width - across) // 2, (height - down) // 2
    part = image[top : top + down, left : left + across]
    small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    _, coded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    moved = Box((box.cx - left) * scale, (box.cy - top) * scale, box.width, box.height)
    return coded.tobytes(), moved.scaled(scale)


class BenchCamera(ClosesItself):
    """Decodes a clip's pictures, at a camera's rate or as fast as vision answers.

    Without a rate one picture waits and the next is decoded while vision works, and none is decoded
    in vain: what comes out is the rate that capture and vision reach together.

    Args:
        clip: is shown.
        clock: stamps the frames: with the time at which their decoding may have begun.
        rate_hz: of the camera; None is as fast as vision answers.
    """

    frame_count: int | None = None
    problem: str | None = None

    def __init__(self, clip: BenchClip, clock: Clock, rate_hz: float | None = None) -> None:
        self._clip = clip
        self._clock = clock
        self.nominal_rate_hz = rate_hz or 0.0
        self._wanted = threading.Semaphore(1)
        self._closed = False
        self._sequence = 0

    def answered(self, record: TrackRecord) -> None:
        """Let the next frame go out; after the first one's answer another one, which waits."""
        self._wanted.release(2 if record.sequence == 0 else 1)

    def read(self) -> Frame | None:
        """Return the next frame when it is due or wanted, None after `close`."""
        sequence, self._sequence = self._sequence, self._sequence + 1
        if self.nominal_rate_hz:
            self._clock.sleep_until(sequence / self.nominal_rate_hz)
        began_s = self._clock.now()
        image = self.picture(self._clip.index(sequence))
        took_s = self._clock.now() - began_s
        if not self.nominal_rate_hz:
            self._wanted.acquire()
        if self._closed:
            return None
        return Frame(image, self._clock.now() - took_s, sequence)

    def picture(self, index: int) -> Image:
        """Return one of the clip's pictures."""
        return self._clip.decoded(index)

    def close(self) -> None:
        """End a `read` that waits."""
        self._closed = True
        self._wanted.release()
