"""Packages that add trackers, detectors and sources; and what they cannot break."""

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from csv_rows import rows_of
from plugin_packages import FAILS_LATE, TRACKER, Site, warnings_in
from program import MAIN, run_from
from rich.console import Console

from follower.apps.command_settings import command_settings
from follower.apps.evaluate.run import EvaluationPlan, evaluate, measure
from follower.apps.main import UNUSABLE, main
from follower.apps.preflight.session import model_states
from follower.apps.video_input import VideoInput
from follower.flight.vision.tracker_factory import make_target_tracker
from follower.settings.settings import Settings, load_settings
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import MonotonicClock
from follower_vision.detection import Detector, detector_names, make_detector
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.models import ModelStore
from follower_vision.plugins import PluginError
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.live_source import LiveSettings
from follower_vision.sources.open import open_source
from follower_vision.trackers.registry import is_tracker, make_tracker, tracker_names
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import TrackState

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "follower-template-tracker"
FRAMES, BOX = 12, Box.from_xywh(60, 80, 40, 40)
MAKE = "def make(find_file, device):\n    return Follows()\n"


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """A patch that moves 5 px a frame to the right, as a data set's sequence."""
    folder = tmp_path / "clip"
    (folder / "img").mkdir(parents=True)
    for number in range(FRAMES):
        cv2.imwrite(str(folder / "img" / f"{number:03}.png"), frame(number).image)
    lines = [f"{60 + 5 * number},80,40,40" for number in range(FRAMES)]
    (folder / "groundtruth.txt").write_text("\n".join(lines), "utf-8")
    return folder


def frame(number: int, left: int | None = None) -> Frame:
    """An image with the patch at this column, or 5 px on from frame to frame; -1 is without it."""
    patch = cv2.resize(np.random.default_rng(6).integers(0, 256, (5, 5, 3), np.uint8), (40, 40))
    image = np.random.default_rng(number).integers(80, 100, (240, 320, 3), np.uint8)
    left = 60 + 5 * number if left is None else left
    if left >= 0:
        image[80:120, left : left + 40] = patch
    return Frame(image, number / 30, number)


def no_file(name: str) -> Path:
    raise AssertionError(f"{name} was asked for")


class Installed:
    """The example package as pip installs it, and the command line that finds it."""

    def __init__(self, folder: Path) -> None:
        source, self.site = folder / "source", folder / "site"
        shutil.copytree(EXAMPLE, source)  # a build leaves its files there
        options = ["--no-deps", "--no-index", "--no-build-isolation", "--quiet"]
        pip = [sys.executable, "-m", "pip", "install", *options, "--target", str(self.site)]
        subprocess.run([*pip, str(source)], check=True, capture_output=True, timeout=200)
        self.folder = folder

    def follower(self, *arguments: str, code: int = 0) -> str:
        command = ("-c", MAIN, *arguments)
        ran = run_from(ROOT, *command, cwd=self.folder, site=(self.site,), codes=(code,))
        return ran.stdout + ran.stderr


@pytest.mark.slow
def test_the_example_is_installed_and_everything_knows_its_tracker(
    tmp_path: Path, clip: Path
) -> None:
    pytest.importorskip("setuptools", reason="pip builds the example with setuptools")
    example = Installed(tmp_path)
    assert "mine" in example.follower("trackers").splitlines()
    assert "tracker: mine" in example.follower("settings", "--set", "tracker=mine")
    assert "mine" in example.follower("settings", "--set", "tracker=none", code=UNUSABLE)
    boxes = tmp_path / "boxes.csv"
    track = ("track", str(clip), "--target", "60,80,40,40", "--tracker", "mine", "--no-video")
    example.follower(*track, "--boxes", str(boxes))
    assert boxes.read_text("utf-8").splitlines()[-1].startswith("11,0.366667,115.000,80.000")
    example.follower(*track, "--detector", "embedded")
    names = ("--trackers", "mine,fusion:mine+none,fusion:mine", "--detector", "embedded")
    example.follower("evaluate", str(clip), *names)
    rows = rows_of(tmp_path / "runs" / "evaluate" / "results.csv")
    success = {row["tracker"]: float(row["success@0.5"]) for row in rows}
    assert success == {"mine": 1.0, "fusion:mine+none": 1.0, "fusion:mine": 1.0}


def test_lists_and_settings_import_nothing_of_a_package(site: Site) -> None:
    site.add("follower-one", "trackers", "one", TRACKER + MAKE)
    site.add("follower-eye", "detectors", "eye", "raise RuntimeError('not asked for')\n")
    assert tracker_names()[-1] == "one"
    assert detector_names(ModelStore(site.folder))[-1] == "eye"
    assert is_tracker("one")
    assert Settings(tracker="one", detector="eye").tracker == "one"
    assert command_settings(tracker="one").tracker == "one"
    assert site.imported() == []
    assert make_tracker("one", no_file).name == "one"
    assert site.imported() == ["follower_one"]


def test_a_name_of_nobody_is_refused_with_those_of_packages(site: Site) -> None:
    site.add("follower-one", "trackers", "one", TRACKER + MAKE)
    site.add("follower-eye", "detectors", "eye", "")
    with pytest.raises(SettingsError, match=r"tracker: there is no 'two'; there are .*, one$"):
        load_settings(overrides=["tracker=two"])
    with pytest.raises(ValueError, match=r"there is no network 'ear'; there are .*, eye$"):
        make_detector("ear", ModelStore(site.folder))


BROKEN = {
    "raise ImportError('no such\\nthing')": "imported: ImportError: no such thing",
    "make = 3": "is none: follower_bad:make cannot be called",
    "": "imported: AttributeError",
    "def make(find_file, device): raise KeyError('x')": "made: KeyError: 'x'",
    "def make(): pass": "made: TypeError",
    "def make(find_file, device): return print": "is none: it has no start, no update",
}


@pytest.mark.parametrize(("code", "why"), BROKEN.items(), ids=map(str, range(len(BROKEN))))
def test_one_that_cannot_be_used_is_named_in_one_line(site: Site, code: str, why: str) -> None:
    site.add("follower-bad", "trackers", "bad", f"{code}\n")
    with pytest.raises(PluginError) as caught:
        make_tracker("bad", no_file)
    said = str(caught.value)
    assert said.startswith("the tracker 'bad' of follower-bad 1.0 ")
    assert why in said
    assert "\n" not in said


@pytest.mark.slow
def test_one_that_is_asked_for_and_cannot_be_used_ends_the_command_in_one_line(
    site: Site, clip: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    site.add("follower-bad", "trackers", "bad", "import no_such_module\n")
    track = ("track", str(clip), "--target", "60,80,40,40", "--tracker", "bad")
    monkeypatch.setattr(sys, "argv", ["follower", *track])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == UNUSABLE
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("follower: the tracker 'bad' of follower-bad 1.0 cannot be imported: ")


@pytest.mark.slow
def test_an_evaluation_leaves_it_out_and_goes_on(site: Site, clip: Path, tmp_path: Path) -> None:
    site.add("follower-bad", "trackers", "bad", "import no_such_module\n")
    said = StringIO()
    names = ["bad", "identity", "fusion:bad+none"]
    assert evaluate(EvaluationPlan([clip], names, out=tmp_path), Console(file=said, width=200)) == 0
    lines = [line for line in said.getvalue().splitlines() if "left out" in line]
    assert [line.split()[0] for line in lines] == ["bad", "fusion:bad+none"]
    assert "of follower-bad 1.0 cannot be imported" in lines[0]
    results = (tmp_path / "evaluate" / "results.csv").read_text("utf-8")
    assert "identity" in results
    assert "bad" not in results


@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_an_evaluation_says_where_one_failed_and_measures_it_again(
    site: Site, clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    fault = "if 'BROKEN' in os.environ: raise OSError('gone')"
    site.add(
        "follower-late", "trackers", "late", f"import os\n{TRACKER}{FAILS_LATE}".format(fault=fault)
    )
    paths = [str(site.folder), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))  # for the other process
    monkeypatch.setenv("BROKEN", "")
    plan = EvaluationPlan([clip], ["late", "identity"], out=tmp_path, workers=workers)
    found = measure(plan)
    (said,) = found.remarks
    assert said.startswith(
        "late on clip: the tracker 'late' of follower-late 1.0 fails, and counts"
    )
    assert said.endswith("OSError: gone")
    assert said in json.loads((found.folder / "results.json").read_text("utf-8"))["remarks"]
    monkeypatch.delenv("BROKEN")
    assert measure(replace(plan, resume=found.folder)).remarks == []


def test_two_packages_with_one_name_are_both_named_and_neither_is_taken(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    for package in ("follower-one", "follower-two"):
        site.add(package, "trackers", "twice", TRACKER + MAKE)
    site.add("follower-three", "trackers", "once", TRACKER + MAKE)
    both = "follower-.* 1.0 and follower-.* 1.0 each have a tracker 'twice': neither is taken"
    with pytest.raises(SettingsError, match=both):
        load_settings(overrides=["tracker=twice"])
    with pytest.raises(PluginError, match=both):
        make_tracker("twice", no_file)
    names = [*tracker_names(), *tracker_names()]
    assert "twice" not in names
    assert "once" in names
    (line,) = warnings_in(caplog)
    assert "follower-one 1.0" in line
    assert "follower-two 1.0" in line


def test_a_built_in_name_stays_the_built_in_one(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-late", "trackers", "correlation", TRACKER + MAKE)
    tracker = make_tracker("correlation", no_file)
    assert type(tracker).__name__ == "CorrelationTracker"
    assert warnings_in(caplog) == []
    assert tracker_names().count("correlation") == 1
    (line,) = warnings_in(caplog)
    assert line.startswith("drone-target-follower and follower-late 1.0 each have a tracker")


FAULTS = {
    "raises": "raise RuntimeError('no more')",
    "box of NaN": "return MotionEstimate(Box(np.nan, 0, 1, 1), 1.0)",
    "confidence of NaN": "return MotionEstimate(self.box, np.nan)",
    "confidence in per cent": "return MotionEstimate(self.box, 90.0)",
    "None": "return None",
}
MAP = """
from follower_vision.trackers.motion_tracker import ResponseMap

class Searches(Follows):
    calls = 0
    def search(self, image, box):
        self.calls += 1
        score = np.full(1, np.nan if self.calls > 10 else 1.0)
        b = self.box
        corners = np.array([[b.left, b.top, b.right, b.bottom]])
        return ResponseMap(corners, score, np.ones(1), box.scaled(4.0))
    def learn(self, image, box, probability):
        if self.calls > 10:
            raise ZeroDivisionError
    def update(self, image):
        self.calls += 1
        return MotionEstimate(self.box, 1.0 if self.calls <= 10 else np.inf)

def make(find_file, device):
    return Searches()
"""


@pytest.fixture
def frail(site: Site) -> Callable[[str], TargetTracker]:
    """Make a target tracker of a package's motion tracker that fails from its eleventh frame on."""

    def make(code: str) -> TargetTracker:
        site.add("follower-frail", "trackers", "frail", TRACKER + code)
        return make_target_tracker(Settings(tracker="frail"))

    return make


_SOUND = MAP.replace("np.inf", "0.0").replace("raise ZeroDivisionError", "pass")
MAP_IN_PER_CENT = _SOUND.replace("np.nan", "90.0")
FAILING = [FAILS_LATE.format(fault=fault) for fault in FAULTS.values()]


@pytest.mark.parametrize("code", [*FAILING, MAP, MAP_IN_PER_CENT], ids=[*FAULTS, "map", "map %"])
def test_a_tracker_that_fails_in_flight_is_named_once_and_the_track_coasts(
    frail: Callable[[str], TargetTracker], caplog: pytest.LogCaptureFixture, code: str
) -> None:
    tracker = frail(code)
    tracker.start(frame(0, 60), BOX)
    tracks = [tracker.step(frame(number, 60 if number < 10 else -1)) for number in range(1, 50)]
    states = [one.state for one in tracks]
    assert set(states[:9]) == {TrackState.TRACKING}
    assert list(dict.fromkeys(states)) == list(TrackState), "tracking, coasting, lost"
    assert all(math.isfinite(one.confidence) for one in tracks)
    (line,) = warnings_in(caplog)
    assert line.startswith("the tracker 'frail' of follower-frail 1.0 fails, and counts as")


MAP_WITH_FEATURES = """
from dataclasses import replace
from follower_vision.trackers.motion_tracker import ResponseMap

class Searches(Follows):
    calls = 0
    def search(self, image, box):
        self.calls += 1
        corners = np.array([[box.left, box.top, box.right, box.bottom]])
        features = np.random.default_rng(0).random((4, 4, 8))
        answer = ResponseMap(corners, np.ones(1), np.ones(1), box.scaled(4.0), features)
        return FAULT if FROM < self.calls < 20 else answer
    def learn(self, image, box, probability):
        pass

def make(find_file, device):
    return Searches()
"""
OF_ANOTHER_SHAPE = {
    "features": "features[None]",
    "features' channels": "features[..., :4]",
    "scores": "np.ones((3, 1)), corners=np.repeat(corners, 3, 0), penalty=np.ones(3)",
    "corners": "corners[:, :2]",
    "region": "None",
    "second": "MotionEstimate(None, 0.5)",
    "penalty": "-np.ones(1)",
}


@pytest.mark.parametrize(("name", "value"), OF_ANOTHER_SHAPE.items(), ids=OF_ANOTHER_SHAPE)
def test_a_map_of_another_shape_is_named_and_ends_no_flight(
    frail: Callable[[str], TargetTracker],
    caplog: pytest.LogCaptureFixture,
    name: str,
    value: str,
) -> None:
    field = "image_features" if name.startswith("features") else name
    fault = f"replace(answer, {field}={value})"
    tracker = frail(MAP_WITH_FEATURES.replace("FAULT", fault).replace("FROM", "10"))
    tracker.start(frame(0, 60), BOX)
    tracks = [tracker.step(frame(number, 60)) for number in range(1, 40)]
    assert {one.state for one in tracks[:9] + tracks[30:]} == {TrackState.TRACKING}
    (line,) = warnings_in(caplog)
    assert line.startswith("the tracker 'frail' of follower-frail 1.0 fails, and counts as")


@pytest.mark.parametrize("first", [0, 10])
def test_a_map_may_lack_its_features_now_and_then(
    frail: Callable[[str], TargetTracker], caplog: pytest.LogCaptureFixture, first: int
) -> None:
    fault = "replace(answer, image_features=None)"
    tracker = frail(MAP_WITH_FEATURES.replace("FAULT", fault).replace("FROM", str(first)))
    tracker.start(frame(0, 60), BOX)
    tracks = [tracker.step(frame(number, 60)) for number in range(1, 40)]
    assert all(one.state is TrackState.TRACKING for one in tracks)
    assert warnings_in(caplog) == []


def test_what_a_failed_tracker_said_last_is_no_observation(
    frail: Callable[[str], TargetTracker],
) -> None:
    tracker = frail(FAILING[0])
    tracker.start(frame(0, 60), BOX)
    for number in range(1, 45):
        left = 60 + 5 * max(number - 10, 0)
        track = tracker.step(frame(number, left))
        near = track.box.iou(Box.from_xywh(left, 80, 40, 40)) > 0.0
        assert near or track.state is not TrackState.TRACKING


EYE = """
from follower_vision.detection.detection import Detection
from follower_vision.geometry.box import Box

class Eye:
    class_names = ("thing",)
    calls = 0
    def detect(self, image, region=None):
        self.calls += 1
        if self.calls > 1:
            raise OSError("the accelerator is gone")
        return [Detection(Box(80, 100, 40, 40), 0, "thing", 0.9)]

def make(find_file, device):
    return Eye()
"""


def test_a_detector_of_a_package_detects_and_its_failure_detects_nothing(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-eye", "detectors", "eye", EYE)
    detector: Detector = make_detector("eye", ModelStore(site.folder))
    assert detector.class_names == ("thing",)
    (found,) = detector.detect(frame(0).image)
    assert found.box == Box(80, 100, 40, 40)
    assert [detector.detect(frame(0).image) for _ in range(3)] == [[], [], []]
    (line,) = warnings_in(caplog)
    assert "the detector 'eye' of follower-eye 1.0 fails" in line
    assert "OSError: the accelerator is gone" in line
    tracker = make_target_tracker(Settings(detector="eye"))
    tracker.start(frame(0), BOX)
    assert tracker.step(frame(1)).state is TrackState.TRACKING
    for name in ("eye", "embedded"):
        assert model_states(Settings(detector=name)) == {}, "preflight wants no file of it"


@pytest.mark.parametrize("names", ["{0: 'thing'}", "None"])
def test_a_detector_whose_classes_have_no_names_is_refused_in_one_line(
    site: Site, names: str
) -> None:
    site.add("follower-eye", "detectors", "eye", EYE.replace('("thing",)', names))
    said = r"^the detector 'eye' of follower-eye 1\.0 is none: its class_names are .*, not names$"
    with pytest.raises(PluginError, match=said):
        make_detector("eye", ModelStore(site.folder))


CAMERA = """
import numpy as np

class Camera:
    rate_hz = 25.0
    def __init__(self, address, clock):
        self.colour, self.clock = int(address), clock
    def images(self):
        for _ in range(3):
            yield np.full((48, 64, 3), self.colour, np.uint8), self.clock.now()
        raise RuntimeError("unplugged")
    def close(self):
        pass

make = Camera
"""
QUICK = LiveSettings(first_frame_s=20, retry_s=0.01, longest_retry_s=0.02)


def test_a_source_of_a_package_is_a_camera_that_is_connected_anew(site: Site) -> None:
    site.add("follower-lens", "sources", "lens", CAMERA)
    assert VideoInput("lens:7").is_live
    assert site.imported() == []
    clock = MonotonicClock()
    with open_source("lens:7", clock=clock, live=QUICK) as source:
        frames = []
        while source.connections < 3:
            newest = source.read()
            assert newest is not None
            frames.append(newest)
        assert source.nominal_rate_hz == 25.0
    assert all(one.image.shape == (48, 64, 3) and one.image.max() == 7 for one in frames)
    assert all(a.captured_s < b.captured_s for a, b in pairwise(frames))


def test_a_source_that_cannot_be_used_is_refused_at_once_and_files_are_files(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.add("follower-lens", "sources", "lens", "import no_such_module\n")
    with pytest.raises(SourceError, match=r"^the source 'lens' of follower-lens 1.0 cannot be im"):
        open_source("lens:7")
    with pytest.raises(SourceError, match="mirror:7"):
        open_source("mirror:7")
    monkeypatch.chdir(tmp_path)
    Path("lens:7").write_bytes(b"no video")
    assert not VideoInput("lens:7").is_live


SEGMENTER = """
from types import SimpleNamespace
import numpy as np

class Segmenter:
    class_names = ("cat", "dog")
    answers = []
    def detect(self, image, region=None):
        return self.answers.pop(0)

def make(find_file, device):
    return Segmenter()
"""


def answers(site: Site, monkeypatch: pytest.MonkeyPatch, *given: object) -> Detector:
    site.add("follower-masks", "detectors", "masks", SEGMENTER)
    detector = make_detector("masks", ModelStore(site.folder))
    monkeypatch.setattr(sys.modules["follower_masks"].Segmenter, "answers", list(given))
    return detector


def shaped(kind: str, **fields: object) -> object:
    """Return detections of the real library, or what is shaped like them."""
    if kind == "supervision":
        return pytest.importorskip("supervision").Detections(**fields)
    return SimpleNamespace(**fields)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["shape", "supervision"])
def test_masks_and_tracks_of_other_libraries_are_detections(
    kind: str, site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = np.array([[0.0, 0, 40, 20], [10, 10, 30, 40], [5, 5, 9, 9]])
    masks = np.zeros((3, 60, 80), bool)
    masks[0, 4:10, 6:20] = True
    found = shaped(
        kind,
        xyxy=corners,
        mask=masks,
        confidence=np.array([0.4, 0.9, 0.8]),
        class_id=np.array([1, 7, 0]),
        tracker_id=np.array([3, 4, -1]),
    )
    bare = shaped(kind, xyxy=np.array([corners[0], [5, 5, 5, 9]]))
    detector = answers(site, monkeypatch, found, bare)
    best, masked = detector.detect(frame(0).image)
    assert (best.class_name, best.score, best.box) == ("7", 0.9, Box.from_xywh(10, 10, 20, 30))
    assert (masked.class_name, masked.box) == ("dog", Box.from_xywh(6, 4, 14, 6)), "of the mask"
    (plain,) = detector.detect(frame(0).image)
    assert (plain.class_name, plain.score, plain.box) == ("cat", 1.0, Box.from_xywh(0, 0, 40, 20))


@pytest.mark.parametrize(
    "wrong",
    [
        {"xyxy": [[0, 0, np.nan, 1]]},
        {"xyxy": [[0, 0, 1, 1]], "confidence": [0.5, 0.5]},
        {"xyxy": [[0, 0, 1, 1]], "confidence": [np.inf]},
        {"xyxy": [[0, 0, 1, 1]], "confidence": [90.0]},
    ],
)
def test_arrays_that_are_no_detections_are_named_and_detect_nothing(
    wrong: dict[str, object],
    site: Site,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    detector = answers(site, monkeypatch, SimpleNamespace(**wrong))
    assert detector.detect(frame(0).image) == []
    (line,) = warnings_in(caplog)
    assert line.startswith("the detector 'masks' of follower-masks 1.0 fails, and counts as seeing")


EMBEDDER = """
import numpy as np

class Eye:
    asked = 0
    def embed(self, image, boxes):
        Eye.asked += 1
        rows = np.array([[box.cx, 1.0, 0.0] for box in boxes])
        return FAULT if Eye.asked > 10 else rows

make = Eye
"""
EMBEDDED = ["rows", "rows * np.nan", "rows[:, :1]", "rows[:-1]", "1 / 0", "None"]


@pytest.mark.parametrize("fault", EMBEDDED)
def test_an_embedder_says_how_alike_things_look_and_its_failure_ends_nothing(
    fault: str, site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-eyes", "embedders", "eyes", EMBEDDER.replace("FAULT", fault))
    settings = load_settings(overrides=["fusion.embedder=eyes", "detector=embedded"])
    assert site.imported() == []
    tracker = make_target_tracker(settings)
    tracker.start(frame(0), BOX)
    tracks = [tracker.step(frame(number)) for number in range(1, 20)]
    assert sys.modules["follower_eyes"].Eye.asked == 20
    assert all(one.state is TrackState.TRACKING for one in tracks), "by structure and colours"
    lines = warnings_in(caplog)
    assert len(lines) == (fault != "rows")
    assert all(line.startswith("the embedder 'eyes' of follower-eyes 1.0 fails") for line in lines)


@pytest.mark.parametrize("fault", EMBEDDED[1:2] + EMBEDDED[4:])
def test_an_embedder_whose_first_answer_fails_is_off_for_the_run_and_the_warning_says_so(
    fault: str, site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    code = EMBEDDER.replace("FAULT", fault).replace("> 10", "== 1")
    site.add("follower-blinks", "embedders", "blinks", code)
    settings = load_settings(overrides=["fusion.embedder=blinks", "detector=embedded"])
    tracker = make_target_tracker(settings)
    tracker.start(frame(0), BOX)
    assert tracker.step(frame(1)).state is TrackState.TRACKING
    assert sys.modules["follower_blinks"].Eye.asked == 1
    (line,) = warnings_in(caplog)
    assert line.startswith(
        "the embedder 'blinks' of follower-blinks 1.0 fails, and is off for the rest of the run: "
    )


def test_an_embedder_of_nobody_is_refused() -> None:
    with pytest.raises(PluginError, match="there is no embedder 'eyes'; there are none"):
        make_target_tracker(load_settings(overrides=["fusion.embedder=eyes", "detector=embedded"]))
