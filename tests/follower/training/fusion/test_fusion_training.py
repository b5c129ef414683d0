"""`follower train fusion`: runs that are put back, fits, folds, and what is written."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from program import output_of

pytest.importorskip("torch")

from follower.training.fusion.driving import (
    RESET_FRAMES,
    CachedDetector,
    ChoiceLog,
    Examples,
    Teacher,
    drive,
    read_sequence,
)
from follower.training.fusion.fitting import FirstPeak, fit_model, fit_noise
from follower.training.fusion.settings import FitSettings, FusionConfig, FusionSetup
from follower.training.fusion.trainer import (
    FittedFusion,
    FusionTrainer,
    fit_one,
    read_choices,
    read_folds,
    sequence_folders,
)
from follower_control.common.strict_config import SettingsError
from follower_vision.detection import Detection
from follower_vision.evaluation.multi_start import Start
from follower_vision.fusion.candidates import SOURCES
from follower_vision.fusion.features import FEATURES
from follower_vision.fusion.model import model_for
from follower_vision.fusion.tracker import Choice, FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.onnx_network import ModelError
from follower_vision.trackers.motion_tracker import IdentityTracker, MotionEstimate

FRAMES = 30
FIT = FitSettings(hidden=4, steps=150, batch=256)


def write_sequence(folder: Path, seed: int, step_px: float = 2.0) -> Path:
    """A textured square that moves over a textured ground."""
    rng = np.random.default_rng(seed)
    ground = cv2.GaussianBlur(rng.integers(0, 255, (120, 200, 3), np.uint8), (0, 0), 2)
    patch = cv2.resize(rng.integers(0, 255, (6, 6, 3), np.uint8), (24, 24))
    (folder / "img").mkdir(parents=True)
    rows = []
    for number in range(FRAMES):
        left, top = round(20 + step_px * number), 40
        image = ground.copy()
        image[top : top + 24, left : left + 24] = patch
        cv2.imwrite(str(folder / f"img/{number + 1:06}.png"), image)
        rows.append(f"{left},{top},24,24")
    (folder / "groundtruth.txt").write_text("\n".join(rows))
    return folder


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("footage")
    for number in range(2):
        write_sequence(folder / f"square{number}", number)
    return folder


def a_config(**changes: object) -> FusionConfig:
    setup = FusionSetup("correlation")
    values = {
        "name": "test",
        "setups": [setup],
        "rounds": 1,
        "folds": 2,
        "jobs": 1,
        "fit": FIT,
    }
    return FusionConfig.model_validate(values | changes)


FOLDS = {"square0": 0, "square1": 1}


@pytest.fixture(scope="module")
def fitted(footage: Path, tmp_path_factory: pytest.TempPathFactory) -> FittedFusion:
    folder = tmp_path_factory.mktemp("fitted")
    return FusionTrainer(a_config(), sequence_folders([footage]), folder, FOLDS).train()


@pytest.mark.slow
def test_a_fit_follows_what_it_has_not_seen(fitted: FittedFusion) -> None:
    assert fitted.figures(FusionSetup("correlation"))["success"] > 0.9
    model = model_for("correlation", str(fitted.path))
    assert 0 < model.noise.place["peak"] < 1
    names = sorted(path.name for path in fitted.path.parent.glob("fold-*.json"))
    assert names == ["fold-0.json", "fold-1.json"]


@pytest.mark.slow
def test_a_fit_goes_on_from_an_earlier_one_with_its_folds(
    fitted: FittedFusion, footage: Path, tmp_path: Path
) -> None:
    places, earlier = sequence_folders([footage]), fitted.path.parent
    trainer = FusionTrainer(a_config(), places, tmp_path / "on", FOLDS, (), earlier)
    assert trainer.train().path.read_text("utf-8") != fitted.path.read_text("utf-8")
    (tmp_path / "half").mkdir()
    shutil.copy(earlier / "fold-0.json", tmp_path / "half")
    with pytest.raises(ModelError, match=r"fold-1\.json"):
        FusionTrainer(a_config(), places, tmp_path / "on", FOLDS, (), tmp_path / "half")


@pytest.mark.slow
def test_the_command_says_what_is_reached_and_fits_the_same_each_time(
    fitted: FittedFusion, footage: Path, tmp_path: Path
) -> None:
    (tmp_path / "folds.json").write_text(json.dumps(FOLDS))
    settings = ["setups=[{tracker: correlation}]", "rounds=1", "jobs=1"]
    settings += [f"fit.{name}={value}" for name, value in asdict(FIT).items()]
    words = ["train", "fusion", "--sequences", str(footage), "--out", str(tmp_path)]
    words += ["--folds", str(tmp_path / "folds.json")]
    for setting in settings:
        words += ["--set", setting]
    assert "out of fold: success" in " ".join(output_of(*words).split())
    again = json.loads((tmp_path / "fusion-nanotrack" / "fitted.json").read_text("utf-8"))
    assert again["models"] == json.loads(fitted.path.read_text("utf-8"))["models"]


class StillTracker(IdentityTracker):
    """Stays where it was put; counts where it was started."""

    def __init__(self) -> None:
        super().__init__()
        self.searched: list[Box] = []

    def update(self, image: Image) -> MotionEstimate:
        estimate = super().update(image)
        self.searched.append(estimate.box)
        return estimate


def test_a_run_is_put_back_on_its_target_after_a_loss(tmp_path: Path) -> None:
    sequence = read_sequence(write_sequence(tmp_path / "fast", 1, step_px=5.0))
    images = list(sequence.frames())
    tracker = FusionTracker(StillTracker(), model=FirstPeak())
    put: list[Box] = []
    put_back = tracker.put_back

    def watched(box: Box) -> None:
        put.append(box)
        put_back(box)

    tracker.put_back = watched  # type: ignore[method-assign]
    examples = drive(tracker, images, sequence, Start("forwards", 0, 1, sequence.initial))
    assert len(put) == 1
    assert put[0] in sequence.truth[RESET_FRAMES[0] :]
    assert len(examples.features) == len(examples.overlaps) == len(examples.sources)
    assert len(np.unique(examples.frames)) == FRAMES - 1


def test_tracks_go_astray_for_a_short_and_a_long_time_in_turn() -> None:
    tracker = FusionTracker(StillTracker(), model=FirstPeak())
    image = np.random.default_rng(1).integers(0, 255, (120, 160, 3), np.uint8)
    track = tracker.start(Frame(image, 0.0, 0), Box(30, 30, 20, 20))
    frames: list[int] = []
    teacher, count = Teacher(tracker), 0
    tracker.put_back = lambda _: frames.append(count)  # type: ignore[method-assign]
    while count < 2 * sum(RESET_FRAMES):
        count += 1
        teacher.correct(track, Box(120, 90, 20, 20))
    short, long = RESET_FRAMES
    assert frames == [short, short + long, 2 * short + long, 2 * (short + long)]


def a_choice(corners: list[list[float]]) -> Choice:
    count = len(corners)
    features = np.arange(count * len(FEATURES), dtype=float).reshape(count, -1)
    sources = tuple(SOURCES[:count])
    return Choice(features, np.array(corners), sources, np.full((count, 3), 0.5), 0)


def test_a_choice_is_written_down_with_its_right_answers() -> None:
    log = ChoiceLog()
    corners = [[10, 10, 30, 30], [10, 10, 30, 50], [100, 100, 120, 120]]
    log.take(a_choice(corners), Box.from_xywh(10, 10, 20, 20))
    log.take(a_choice(corners[:1]), None)
    examples = log.examples()
    assert examples.overlaps.tolist() == pytest.approx([1.0, 0.5, 0.0, 0.0])
    assert examples.frames.tolist() == [0, 0, 0, 1]
    assert examples.residuals[0].tolist() == [0, 0, 0, 0]
    assert np.isnan(examples.residuals[1:]).all()


def some_examples(seed: int, count: int = 3000, deviation: float = 0.1) -> Examples:
    """A candidate is right with a probability that its first feature tells."""
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(count, len(FEATURES))).astype(np.float32)
    right = rng.random(count) < 1 / (1 + np.exp(-2 * features[:, 0]))
    residuals = np.full((count, 4), np.nan, np.float32)
    residuals[right] = rng.normal(0, deviation, (int(right.sum()), 4))
    sources = np.zeros(count, np.int64)
    return Examples(features, right * 0.9, np.arange(count), sources, residuals)


@pytest.mark.slow
def test_a_fit_is_calibrated_and_finds_what_counts() -> None:
    settings = FitSettings(hidden=4, steps=400, batch=1024)
    model = fit_model([some_examples(1), some_examples(2)], FirstPeak.noise, settings)
    unseen = some_examples(3)
    told = model.probabilities(unseen.features)[:, 1]
    right = unseen.overlaps > 0.5
    for low in (0.0, 0.25, 0.5, 0.75):
        there = (told >= low) & (told < low + 0.25)
        assert told[there].mean() == pytest.approx(right[there].mean(), abs=0.08)
    expected = 1 / (1 + np.exp(-2 * unseen.features[:, 0]))
    assert np.abs(told - expected).mean() < 0.08


def test_what_was_the_same_in_all_runs_gets_no_say() -> None:
    examples = some_examples(1, count=200)
    examples.features[:, -1] = 0.3
    model = fit_model([examples], FirstPeak.noise, FitSettings(hidden=2, steps=3, batch=64))
    other = examples.features.copy()
    other[:, -1] = 100.0
    assert np.array_equal(model.probabilities(other), model.probabilities(examples.features))
    assert model.to_json()["features"] == list(FEATURES[:-1])


def still(count: int) -> Iterator[Box]:
    yield from (Box(100, 100, 20, 20) for _ in range(count))


def test_the_noise_of_an_observation_is_that_of_its_residuals() -> None:
    noise = fit_noise([some_examples(4, deviation=0.1)], [list(still(50))])
    assert noise.place["peak"] == pytest.approx(0.1, rel=0.1)
    assert noise.size["peak"] == pytest.approx(0.1, rel=0.1)


def test_targets_that_manoeuvre_have_more_noise_of_motion() -> None:
    swaying = [Box(100 + 40 * math.sin(k / 2), 100, 20, 20) for k in range(100)]
    examples = some_examples(5)
    calm = fit_noise([examples], [list(still(100))])
    wild = fit_noise([examples], [swaying])
    assert wild.manoeuvre > calm.manoeuvre


class Counter:
    """Sees one thing; counts how often it is asked."""

    class_names = ("thing",)

    def __init__(self) -> None:
        self.asked = 0

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        self.asked += 1
        return [Detection(Box(5, 5, 4, 4), 0, "thing", 0.9)]


def test_detections_are_kept_from_one_run_to_the_next(tmp_path: Path) -> None:
    images: list[Image] = [np.full((8, 8, 3), grey, np.uint8) for grey in range(2)]
    detector, path = Counter(), tmp_path / "kept.pkl"
    region = Box(4, 4, 8, 8)
    for _ in range(2):
        cached = CachedDetector(detector, images, path)
        answers = [cached.detect(image, where) for image in images for where in (None, region)]
        cached.save()
    assert detector.asked == 4
    assert all(one.box == Box(5, 5, 4, 4) for (one,) in answers)


def test_another_sequence_of_the_same_name_is_looked_at_anew(tmp_path: Path) -> None:
    detector, path = Counter(), tmp_path / "car.pkl"
    for grey in range(2):
        image = np.full((8, 8, 3), grey, np.uint8)
        cached = CachedDetector(detector, [image], path)
        cached.detect(image)
        cached.save()
    assert detector.asked == 2


def test_what_cannot_be_used_is_one_clear_line(footage: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="no such folder"):
        sequence_folders([tmp_path / "nothing"])
    (tmp_path / "other" / "square1").mkdir(parents=True)
    with pytest.raises(SettingsError, match="rename one"):
        sequence_folders([footage, tmp_path / "other"])
    with pytest.raises(SettingsError, match="at least two folds"):
        FusionTrainer(a_config(), sequence_folders([footage])[:1], tmp_path)
    with pytest.raises(SettingsError, match="no fold for square0"):
        FusionTrainer(a_config(), sequence_folders([footage]), tmp_path, {"square1": 0})
    with pytest.raises(SettingsError, match="no sequence here"):
        read_sequence(tmp_path / "other" / "square1")
    gone = write_sequence(tmp_path / "gone", 1)
    (gone / "groundtruth.txt").write_text("20,40,24,24\n" + "0,0,0,0\n" * (FRAMES - 1))
    with pytest.raises(SettingsError, match="gone: no box after the first frame"):
        read_sequence(gone)
    (tmp_path / "folds.json").write_text("[1]")
    with pytest.raises(SettingsError, match="write"):
        read_folds(tmp_path / "folds.json")
    with pytest.raises(SettingsError, match="No such file"):
        read_folds(tmp_path / "missing.json")


def test_choices_are_kept_in_a_file_and_every_fit_learns_from_them(tmp_path: Path) -> None:
    log = ChoiceLog()
    log.take(a_choice([[10, 10, 30, 30], [100, 100, 120, 120]]), Box.from_xywh(10, 10, 20, 20))
    log.examples().save(tmp_path / "7.npz")
    (kept,) = read_choices(tmp_path)
    assert kept.features.tolist() == log.examples().features.tolist()
    assert kept.overlaps.tolist() == [1.0, 0.0]
    rows = np.random.default_rng(1).normal(size=(300, len(FEATURES)))
    zeros = np.zeros(300, np.int64)
    believed = Examples(rows, (rows[:, 0] > 0) * 1.0, zeros, zeros, np.full((300, 4), np.nan))
    doubted = Examples(rows, (rows[:, 0] < 0) * 1.0, zeros, zeros, np.full((300, 4), np.nan))
    probable = [
        fit_one([believed], [[Box(5, 5, 4, 4)]], a_config(), others).probabilities(rows[:1])[0, 1]
        for others in ([], [doubted] * 5)
    ]
    assert (probable[0] > 0.5) != (probable[1] > 0.5)


@pytest.mark.parametrize("content", [b"", b"no zip", None])
def test_files_of_choices_that_cannot_be_used_are_one_clear_line(
    tmp_path: Path, content: bytes | None
) -> None:
    if content is None:
        with pytest.raises(SettingsError, match=r"there is no \.npz file"):
            read_choices(tmp_path)
        return
    (tmp_path / "1.npz").write_bytes(content)
    with pytest.raises(SettingsError, match=r"1\.npz: no file of choices"):
        read_choices(tmp_path)


def test_choices_of_other_features_are_refused(tmp_path: Path) -> None:
    few = np.zeros((1, 3))
    one = np.zeros(1, np.int64)
    Examples(few, np.zeros(1), one, one, np.zeros((1, 4))).save(tmp_path / "1.npz")
    with pytest.raises(SettingsError, match="other features"):
        read_choices(tmp_path)
