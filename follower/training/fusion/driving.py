"""Runs of Fusion over sequences, in which each choice is written down with its right answer."""

from __future__ import annotations

import pickle
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from follower.training.fusion.settings import FusionSetup
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import Detection, Detector, OnnxDetector, make_detector
from follower_vision.disk import write_whole_bytes
from follower_vision.evaluation.datasets import load_dataset
from follower_vision.evaluation.multi_start import RATE_HZ, Run, Start, run
from follower_vision.evaluation.one_pass import DatasetError, Sequence, start_box
from follower_vision.fusion.candidates import SOURCES, corners_of
from follower_vision.fusion.features import FEATURES
from follower_vision.fusion.model import ProbabilityModel
from follower_vision.fusion.tracker import Choice, FusionTracker
from follower_vision.geometry.box import Box, pairwise_iou
from follower_vision.images.frame import Frame, Image
from follower_vision.models import ModelStore, default_folder
from follower_vision.models.download import sha256_of
from follower_vision.trackers.registry import make_tracker
from follower_vision.trackers.track import Track

Floats = npt.NDArray[np.floating]

RESET_FRAMES = (20, 100)
"""After so many frames in a row beside the target a run is put back on it, in turn.

If it were 20 each time, no track would go astray for long, and a model that was fitted to such runs
would believe one that does.
"""
_LOST_IOU = 0.1


@dataclass(slots=True)
class Examples:
    """What was chosen from, with the right answers.

    Attributes:
        features: (N, F) of the candidates.
        overlaps: (N,) each candidate's intersection over union with the truth.
        frames: (N,) number of the choice that a candidate belongs to.
        sources: (N,) index into `SOURCES`.
        residuals: (N, 4) how the true box lies to the candidate's: centre in target sizes, log
            sides; NaN where the overlap is below 0.5.
    """

    features: Floats
    overlaps: Floats
    frames: npt.NDArray[np.int64]
    sources: npt.NDArray[np.int64]
    residuals: Floats

    @classmethod
    def joined(cls, parts: Iterable[Examples]) -> Examples:
        """Put several logs together; their frames stay apart."""
        kept = list(parts)
        offset, frames = 0, []
        for one in kept:
            frames.append(one.frames + offset)
            offset += int(one.frames.max(initial=-1)) + 1
        return cls(
            np.concatenate([one.features for one in kept]),
            np.concatenate([one.overlaps for one in kept]),
            np.concatenate(frames),
            np.concatenate([one.sources for one in kept]),
            np.concatenate([one.residuals for one in kept]),
        )

    def save(self, path: Path) -> None:
        """Write them as an .npz file, for `follower train fusion --choices`."""
        np.savez_compressed(path, **asdict(self))

    @classmethod
    def load(cls, path: Path) -> Examples:
        """Read what `save` wrote.

        Raises:
            SettingsError: the file cannot be used, or is of other features.
        """
        try:
            with np.load(path, allow_pickle=False) as stored:
                found = cls(**{one.name: stored[one.name] for one in fields(cls)})
        except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
            raise SettingsError(f"--choices {path}: no file of choices ({error})") from None
        if found.features.shape[1] != len(FEATURES):
            raise SettingsError(f"--choices {path}: written with other features; make it again")
        return found


@dataclass(slots=True)
class ChoiceLog:
    """Takes Fusion's choices of one run."""

    features: list[Floats] = field(default_factory=list)
    overlaps: list[Floats] = field(default_factory=list)
    sources: list[int] = field(default_factory=list)
    residuals: list[Floats] = field(default_factory=list)

    def take(self, choice: Choice, truth: Box | None) -> None:
        """Write a choice down, and where the target truly is, in pixels; None is nowhere."""
        count = len(choice.corners)
        overlaps: Floats = np.zeros(count)
        residuals = np.full((count, 4), np.nan)
        if truth is not None:
            true = corners_of([truth])
            overlaps = pairwise_iou(choice.corners, true)[:, 0]
            close = overlaps > 0.5
            residuals[close] = (_placed(true) - _placed(choice.corners[close])) / np.array(
                [truth.scale, truth.scale, 1.0, 1.0]
            )
        self.features.append(choice.features.astype(np.float32))
        self.overlaps.append(overlaps.astype(np.float32))
        self.sources += [SOURCES.index(source) for source in choice.sources]
        self.residuals.append(residuals.astype(np.float32))

    def examples(self) -> Examples:
        """Return all that was taken."""
        counts = [len(one) for one in self.overlaps]
        return Examples(
            np.concatenate(self.features),
            np.concatenate(self.overlaps),
            np.repeat(np.arange(len(counts)), counts),
            np.array(self.sources),
            np.concatenate(self.residuals),
        )


def _placed(corners: Floats) -> Floats:
    """Centre x, y and log width, log height of corners, (N, 4)."""
    sides = corners[:, 2:] - corners[:, :2]
    return np.hstack([(corners[:, :2] + corners[:, 2:]) / 2, np.log(sides)])


class CachedDetector:
    """A detector that remembers its answers about the images of one sequence.

    Fusion's regions lie on a grid, so that runs that differ a little share them. Images are known
    by their content: another sequence may have the same name.

    Args:
        detector: asked once for each image and region.
        images: of the sequence.
        path: where the answers are kept.
    """

    def __init__(self, detector: Detector, images: list[Image], path: Path) -> None:
        self._detector = detector
        self._checksums = {id(image): zlib.crc32(image.tobytes()) for image in images}
        self._path = path
        self._known: dict[tuple[object, ...], list[Detection]] = {}
        self._asked = 0
        if path.is_file():
            self._known = pickle.loads(path.read_bytes())  # noqa: S301 - written by `save`

    @property
    def class_names(self) -> tuple[str, ...]:
        """See `Detector`."""
        return self._detector.class_names

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """See `Detector`."""
        place = () if region is None else (region.cx, region.cy, region.width, region.height)
        key = (self._checksums[id(image)], *place)
        if key not in self._known:
            self._known[key] = self._detector.detect(image, region)
            self._asked += 1
        return self._known[key]

    def save(self) -> None:
        """Write what is new."""
        if self._asked:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_whole_bytes(self._path, pickle.dumps(self._known))


class Teacher:
    """Writes a Fusion tracker's choices down, and puts it back on its target after each loss.

    Losses of `RESET_FRAMES` in turn: short ones keep to the target, long ones teach doubt.

    Args:
        tracker: follows; its listener is taken.
    """

    def __init__(self, tracker: FusionTracker) -> None:
        self._tracker = tracker
        self._log = ChoiceLog()
        self._choice: Choice | None = None
        self._lost = self._losses = 0
        tracker.listener = self._listen

    def _listen(self, choice: Choice) -> None:
        self._choice = choice

    def correct(self, track: Track, truth: Box | None) -> None:
        """Take a step's answer, and where the target truly was, in pixels; None is nowhere."""
        if self._choice is not None:
            self._log.take(self._choice, truth)
            self._choice = None
        if truth is not None:
            self._lost = self._lost + 1 if track.box.iou(truth) < _LOST_IOU else 0
            if self._lost >= RESET_FRAMES[self._losses % len(RESET_FRAMES)]:
                self._tracker.put_back(truth)
                self._lost = 0
                self._losses += 1

    def examples(self) -> Examples:
        """Return all choices so far."""
        return self._log.examples()


def drive(
    tracker: FusionTracker, images: list[Image], sequence: Sequence, start: Start
) -> Examples:
    """Let Fusion follow from a start, put it back after each loss, and write its choices down."""
    teacher = Teacher(tracker)
    stop = len(images) if start.step > 0 else -1
    first = images[start.frame]
    tracker.start(Frame(first, 0.0, 0), start_box(start.box, first))
    for number, index in enumerate(range(start.frame + start.step, stop, start.step), 1):
        track = tracker.step(Frame(images[index], number / RATE_HZ, number))
        teacher.correct(track, sequence.truth[index])
    return teacher.examples()


def driven(
    place: Path, setups: Iterable[FusionSetup], model: ProbabilityModel, cache: Path
) -> Examples:
    """Run over one sequence, forwards and backwards, with each setup; return the choices."""
    sequence = read_sequence(place)
    images = list(sequence.frames())
    logs = []
    for setup in setups:
        with _tracker(setup, images, cache / f"{place.name}.pkl") as make:
            logs += [drive(make(model), images, sequence, one) for one in ends(sequence)]
    return Examples.joined(logs)


def run_fusion(
    place: Path,
    setup: FusionSetup,
    model: ProbabilityModel,
    cache: Path,
    begins: Callable[[Sequence], Iterable[Start]],
) -> list[Run]:
    """Run over one sequence from each of the starts that `begins` gives, without correction."""
    sequence = read_sequence(place)
    images = list(sequence.frames())
    with _tracker(setup, images, cache / f"{place.name}.pkl") as make:
        return [run(make(model), images, sequence, start) for start in begins(sequence)]


@contextmanager
def _tracker(
    setup: FusionSetup, images: list[Image], cache: Path
) -> Iterator[Callable[[ProbabilityModel], FusionTracker]]:
    """Give what makes a tracker; the detections are kept afterwards."""
    store = ModelStore(default_folder())
    detector = None
    if setup.detector is not None:
        asked = make_detector(setup.detector, store)
        parts = [cache.stem, Path(setup.detector).stem]
        if isinstance(asked, OnnxDetector):  # one trained anew has other answers
            parts.append(sha256_of(asked.path)[:12])
        detector = CachedDetector(asked, images, cache.with_name("-".join(parts) + ".pkl"))
    yield lambda model: FusionTracker(
        make_tracker(setup.tracker, store.file), detector, model=model
    )
    if detector is not None:
        detector.save()


def ends(sequence: Sequence) -> Iterator[Start]:
    """The first frame, forwards, and the last one with the target, backwards."""
    yield Start("forwards", 0, 1, sequence.initial)
    last, box = max((k, box) for k, box in enumerate(sequence.truth) if box is not None)
    if last > 0:
        yield Start("backwards", last, -1, box)


def read_sequence(place: Path) -> Sequence:
    """Return the sequence in a folder.

    Raises:
        SettingsError: there is none, or several, or nothing to follow in it.
    """
    try:
        found, problems = load_dataset(place)
    except DatasetError as error:
        raise SettingsError(str(error)) from None
    if len(found) != 1:
        reason = problems[0] if problems else f"it holds {len(found)} sequences"
        raise SettingsError(f"{place}: expected one sequence: {reason}")
    if not any(found[0].truth[1:]):
        raise SettingsError(f"{place}: no box after the first frame")
    return found[0]
