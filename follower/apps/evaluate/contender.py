"""What is compared: trackers by their names on the command line."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import TypeAdapter

from follower.flight.vision.tracker_factory import make_fusion
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import Clock
from follower_vision.detection import make_detector
from follower_vision.disk import write_whole
from follower_vision.evaluation.one_pass import DatasetError, Sequence, read_image, start_box
from follower_vision.fusion import FusionSettings
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.models import ModelStore, default_folder
from follower_vision.plugins import telling_failures
from follower_vision.trackers.motion_tracker import MotionEstimate, MotionTracker
from follower_vision.trackers.registry import is_tracker, make_tracker
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import Track, TrackState

_KINDS = ("fusion", "fusion-paper")
_MOTION = "nanotrack-v3"
_NONE = "none"
"""What a name says in a detector's place to do without one."""


@dataclass(frozen=True, slots=True)
class Contender:
    """A tracker to be measured.

    Attributes:
        name: as on the command line: a motion tracker, or KIND:MOTION+DETECTOR, of which the
            motion tracker (nanotrack-v3) and the detector may be left out; "none" is no detector.
        default_detector: where the name says nothing of one.
    """

    name: str
    default_detector: str

    def __post_init__(self) -> None:
        if not is_tracker(self.motion) or (self.asked_detector and not self.detector):
            raise SettingsError(
                f"--trackers {self.name}: write a name from `follower trackers`, a network's "
                f"path, or one of {', '.join(_KINDS)}, alone or as KIND:NAME or KIND:NAME+DETECTOR"
            )
        if self.kind == "fusion-paper" and self.detector == _NONE:
            raise SettingsError(f"--trackers {self.name}: the paper's algorithm needs a detector")

    @property
    def kind(self) -> str:
        """Either "fusion", "fusion-paper", or "" for a motion tracker alone."""
        head = self.name.partition(":")[0].partition("+")[0]
        return head if head in _KINDS else ""

    @property
    def motion(self) -> str:
        """The motion tracker's name."""
        rest = self.name.removeprefix(self.kind).partition("+")[0].removeprefix(":")
        return rest if rest or not self.kind else _MOTION

    @property
    def asked_detector(self) -> str:
        """The detector that the name asks for, "" if none."""
        return self.name.partition("+")[2]

    @property
    def detector(self) -> str:
        """The detector's name, "none" to do without one, "" for a motion tracker alone."""
        return (self.asked_detector or self.default_detector) if self.kind else ""

    @property
    def network(self) -> str | None:
        """The detector that is to be made, None for none."""
        return None if self.detector in ("", _NONE) else self.detector

    @property
    def identity(self) -> str:
        """What a stored result must agree with."""
        return f"{self.kind or 'motion'} {self.motion} {self.detector}".strip()

    def make(self) -> TargetTracker:
        """Return a fresh tracker.

        Raises:
            ModelError: a network is missing.
        """
        store = ModelStore(default_folder())
        motion = make_tracker(self.motion, store.file)
        if not self.kind:
            return AlwaysBelieved(motion)
        settings = FusionSettings.paper() if self.kind == "fusion-paper" else FusionSettings()
        detector = None if self.network is None else make_detector(self.network, store)
        return make_fusion(motion, detector, settings)

    def start(self, frame: Frame, box: Box) -> tuple[TargetTracker, Track]:
        """Return a fresh tracker that was started, and its first track.

        Args:
            frame: the first.
            box: the target's, in pixels; what of it lies inside the image is the tracker's.

        Raises:
            DatasetError: nothing of it lies inside, or too little for this tracker.
            ModelError: a network is missing.
        """
        inside = start_box(box, frame.image)
        tracker = self.make()
        try:
            return tracker, tracker.start(frame, inside)
        except ValueError as error:
            raise DatasetError(f"{self.name} cannot start there: {error}") from None


class AlwaysBelieved:
    """A motion tracker as a target tracker that never says that it lost its target."""

    def __init__(self, motion: MotionTracker) -> None:
        self._motion = motion

    def start(self, frame: Frame, box: Box) -> Track:
        """See `TargetTracker`."""
        self._motion.start(frame.image, box)
        return self._track(frame, MotionEstimate(box, 1.0))

    def step(self, frame: Frame) -> Track:
        """See `TargetTracker`."""
        return self._track(frame, self._motion.update(frame.image))

    def _track(self, frame: Frame, estimate: MotionEstimate) -> Track:
        return Track(
            estimate.box,
            TrackState.TRACKING,
            estimate.confidence,
            self._motion.name,
            frame.captured_s,
            frame.sequence,
        )


@dataclass(frozen=True, slots=True)
class RunStart:
    """Where a run starts: `kind` is "ope", "tre" or "sre"."""

    kind: str
    number: int
    frame: int
    box: Box


@dataclass(frozen=True, slots=True)
class EvaluationResult:
    """What a tracker answered, from its first frame on.

    Attributes:
        boxes: one a frame; None where it gave none.
        states: one a frame; None for a tracker that knows no states.
        frame_s: one a frame, by the clock: of making and starting the tracker, then of each
            update; empty for the boxes of another program.
        processor_s: time of all updates by the processor, all threads together.
        failures: what parts of other packages did wrong, in words.
    """

    boxes: tuple[Box | None, ...]
    states: tuple[TrackState, ...] | None = None
    frame_s: tuple[float, ...] = ()
    processor_s: float = 0.0
    failures: tuple[str, ...] = ()

    @property
    def busy_s(self) -> float:
        """Time of all updates by the clock, without the start."""
        return sum(self.frame_s[1:])


def run(
    contender: Contender, sequence: Sequence, start: RunStart, rate_hz: float, clock: Clock
) -> EvaluationResult:
    """Run a fresh tracker from a start to the sequence's end; reading images is not timed.

    Args:
        contender: what to run.
        sequence: what to run over.
        start: where to begin.
        rate_hz: the frames a second that the tracker is given.
        clock: times the updates.

    Raises:
        DatasetError: the tracker cannot start from the first box.
        OSError: an image cannot be read.
        ModelError: a network is missing.
    """
    failures: list[str] = []
    with telling_failures(failures.append):
        result = _run(contender, sequence, start, rate_hz, clock)
    return replace(result, failures=tuple(failures))


def _run(
    contender: Contender, sequence: Sequence, start: RunStart, rate_hz: float, clock: Clock
) -> EvaluationResult:
    images = sequence.images[start.frame :]
    first = Frame(read_image(images[0]), 0.0, 0)
    begin_s = clock.now()
    tracker, track = contender.start(first, start.box)
    tracks, frame_s, processor_s = [track], [clock.now() - begin_s], 0.0
    for number, path in enumerate(images[1:], 1):
        frame = Frame(read_image(path), number / rate_hz, number)
        begin_s, processor_begin_s = clock.now(), time.process_time()
        tracks.append(tracker.step(frame))
        frame_s.append(clock.now() - begin_s)
        processor_s += time.process_time() - processor_begin_s
    boxes = (start_box(start.box, first.image), *(track.box for track in tracks[1:]))
    states = tuple(track.state for track in tracks) if contender.kind else None
    return EvaluationResult(boxes, states, tuple(frame_s), processor_s)


_STORED = TypeAdapter(tuple[tuple[str, float, int, Box], EvaluationResult])


class ResultStore:
    """The results in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def save(
        self,
        contender: Contender,
        sequence: Sequence,
        start: RunStart,
        rate_hz: float,
        result: EvaluationResult,
    ) -> None:
        """Write a result atomically."""
        path = self._path(contender, sequence, start)
        path.parent.mkdir(parents=True, exist_ok=True)
        key = _key(contender, start, rate_hz)
        write_whole(path, _STORED.dump_json((key, result)).decode())

    def load(
        self, contender: Contender, sequence: Sequence, start: RunStart, rate_hz: float
    ) -> EvaluationResult | None:
        """Return the result of the same run, None if there is none without a failure."""
        path = self._path(contender, sequence, start)
        if not path.is_file():
            return None
        try:
            key, result = _STORED.validate_json(path.read_bytes())
        except ValueError:
            return None
        whole = len(result.boxes) == len(sequence.images) - start.frame
        same = key == _key(contender, start, rate_hz)
        return result if whole and same and not result.failures else None

    def _path(self, contender: Contender, sequence: Sequence, start: RunStart) -> Path:
        name = contender.name.replace(":", "@").replace("/", "_")
        return self._folder / name / sequence.name / f"{start.kind}-{start.number}.json"


def _key(contender: Contender, start: RunStart, rate_hz: float) -> tuple[str, float, int, Box]:
    return contender.identity, rate_hz, start.frame, start.box
