"""A bench as it runs: real threads, networks, recordings and MAVLink, on tiny pictures."""

import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from plugin_packages import installed
from rich.console import Console

from follower.apps.bench.measure import NotMeasuredError, measure
from follower.apps.bench.result import BenchSetup, read_bench
from follower.apps.bench.run import BenchOptions, bench
from follower.apps.bench.scene import BenchCamera, BenchClip, render_clips
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import MonotonicClock

SMALL, LARGE = (160, 120), (256, 144)
SECONDS = 0.3
INTERRUPTED = 130


@pytest.fixture(scope="module")
def clips() -> dict[tuple[int, int], BenchClip]:
    made = render_clips((SMALL, LARGE), 4)
    assert made is not None
    return made


def setup(tracker: str, detector: str | None = None, **more: object) -> BenchSetup:
    return BenchSetup.model_validate(
        {"tracker": tracker, "detector": detector, "width": SMALL[0], "height": SMALL[1], **more}
    )


@pytest.mark.slow
def test_the_clips_show_the_same_flight_with_the_target_in_its_true_box(
    clips: dict[tuple[int, int], BenchClip],
) -> None:
    for size, clip in clips.items():
        assert len(clip.pictures) == len(clip.boxes) == 4
        image, box = clip.decoded(0), clip.boxes[0]
        assert image.shape == (size[1], size[0], 3)
        inside = image[round(box.top) : round(box.bottom), round(box.left) : round(box.right)]
        redness = inside[..., 2].astype(int) - inside[..., 0]
        around = image[..., 2].astype(int) - image[..., 0]
        assert np.percentile(redness, 90) > np.percentile(around, 90) + 20, "the red car"
    assert [clips[SMALL].index(number) for number in range(8)] == [0, 1, 2, 3, 2, 1, 0, 1]


@pytest.mark.slow
def test_rendering_ends_when_it_is_told_to() -> None:
    asked: list[None] = []
    assert render_clips((SMALL,), 50, lambda: bool(asked.append(None))) is None
    assert len(asked) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "flown",
    [
        setup("correlation"),
        setup("re3", "follower-detector"),
        setup("correlation", video=False, camera_hz=30.0),
    ],
    ids=lambda flown: f"{flown.name} {flown.camera_hz}",
)
def test_a_set_up_is_flown_for_real_and_all_its_figures_are_numbers(
    clips: dict[tuple[int, int], BenchClip], tmp_path: Path, flown: BenchSetup
) -> None:
    row = measure(flown, clips[SMALL], SECONDS, tmp_path)
    assert row.model_dump(include=set(BenchSetup.model_fields)) == flown.model_dump()
    figures = row.model_dump(exclude={*BenchSetup.model_fields, "temperature_c", "throttled"})
    assert all(math.isfinite(value) and value >= 0 for value in figures.values())
    assert min(row.frames, row.rate_hz, row.step_ms, row.control_ms, row.delay_ms, row.cores) > 0
    assert row.late_ms <= row.late_p99_ms <= row.late_max_ms
    assert row.on_target > 0.5
    assert list(tmp_path.iterdir()) == [], "nothing of the recording is left"


@pytest.mark.slow
def test_setpoints_go_out(clips: dict[tuple[int, int], BenchClip], tmp_path: Path) -> None:
    """Tried again where a computer that stands still for a moment makes the supervisor hold."""
    tries = (measure(setup("correlation"), clips[SMALL], SECONDS, tmp_path) for _ in range(5))
    assert any(row is not None and row.sent > 0.5 for row in tries)


@pytest.mark.slow
def test_a_camera_with_a_rate_gives_no_more_than_that() -> None:
    made = render_clips((SMALL,), 2)
    clock = MonotonicClock()
    with BenchCamera(made[SMALL], clock, 50.0) as camera:
        frames = [camera.read() for _ in range(6)]
    assert clock.now() >= 5 / 50
    stamps = [frame.captured_s for frame in frames if frame is not None]
    assert len(stamps) == 6
    assert stamps == sorted(stamps)


@pytest.mark.slow
def test_what_is_not_there_is_said_in_a_line(
    clips: dict[tuple[int, int], BenchClip], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path / "none"))
    with pytest.raises(NotMeasuredError, match=r"nanotrack-v3: .*no such network"):
        measure(setup("nanotrack-v3"), clips[SMALL], SECONDS, tmp_path)
    with pytest.raises(NotMeasuredError, match=r"re3, rocm: .*runs on the processor"):
        measure(setup("re3", device="rocm"), clips[SMALL], SECONDS, tmp_path)


@pytest.mark.slow
def test_a_bench_writes_figures_picture_and_settings_and_is_remembered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    options = BenchOptions(
        sizes=(SMALL, LARGE),
        pictures=3,
        trackers=("correlation",),
        detectors=("follower-detector",),
        budget_s=8.0,
        name="a board",
        note="by a test",
    )
    assert bench(options, tmp_path / "runs", Console(quiet=True)) == 0
    folder = tmp_path / "runs" / "bench"
    result = read_bench(folder / "bench.json")
    flown = [(row.detector, row.size, row.video) for row in result.rows if row.camera_hz is None]
    planned = [
        ("follower-detector", size, video) for video in (True, False) for size in result.sizes
    ] + [(None, size, True) for size in result.sizes]
    assert flown == planned[: len(flown)]
    assert len(flown) == len(planned) or "no time" in result.remarks[-1]
    assert [row.camera_hz is None for row in result.rows] == [True] * len(flown) + [False]
    assert (result.name, result.note) == ("a board", "by a test")
    assert cv2.imread(str(folder / "bench.png")) is not None
    assert yaml.safe_load((folder / "advised.yaml").read_text())["tracker"] == "correlation"
    assert read_bench(tmp_path / "cache" / "follower" / "bench.json") == result
    assert sorted(path.name for path in folder.iterdir()) == [
        "advised.yaml",
        "bench.json",
        "bench.png",
    ]


def test_a_disk_on_which_a_flight_would_leave_its_video_out_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=100_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(SettingsError, match=r"100\.0 MB free: too little for the videos"):
        bench(BenchOptions(sizes=(SMALL,), pictures=3), tmp_path / "runs", Console(quiet=True))
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_ctrl_c_ends_in_order_and_keeps_what_was_measured(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from follower.apps.bench.run import *\n"
        "options = BenchOptions(sizes=((160, 120),), pictures=3, budget_s=12.0,\n"
        "    trackers=('correlation', 're3'))\n"
        "sys.exit(bench(options, Path('runs')))"
    )
    program = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        recordings = tmp_path / "runs" / "bench"
        seen: set[str] = set()
        end_s = time.monotonic() + 200
        while len(seen) < 2:  # the second set-up has begun
            assert time.monotonic() < end_s
            assert program.poll() is None
            if recordings.is_dir():
                seen |= {path.name for path in recordings.iterdir()}
            time.sleep(0.02)
        program.send_signal(signal.SIGINT)
        said, _ = program.communicate(timeout=90)
    finally:
        program.kill()
    assert program.returncode == INTERRUPTED, said
    assert "Traceback" not in said
    assert len(read_bench(recordings / "bench.json").rows) >= 1
    assert "frames/s here" in said


SEES_NOTHING = """
class SeesNothing:
    class_names = ("thing",)

    def detect(self, image, region=None):
        return []


def make(find_file, device):
    return SeesNothing()
"""


@pytest.mark.slow
def test_parts_of_other_packages_are_measured_and_broken_ones_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with installed(tmp_path / "site") as site:
        site.add("follower-eye", "detectors", "eye", SEES_NOTHING)
        site.add("follower-bad", "trackers", "bad", "import no_such_module\n")
        names = ("correlation", "bad", "nanotrack-v3")
        monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path / "no-models"))
        options = BenchOptions(
            sizes=(SMALL,), pictures=3, trackers=names, detectors=("eye",), budget_s=8.0
        )
        assert bench(options, tmp_path / "runs", Console(quiet=True)) == 0
    result = read_bench(tmp_path / "runs" / "bench" / "bench.json")
    assert {row.tracker for row in result.rows} == {"correlation"}
    assert result.rows[0].detector == "eye"
    left_out, missing = result.remarks[:2]
    assert left_out.startswith("bad is left out: the tracker 'bad' of follower-bad 1.0 cannot be")
    assert missing == "without nanotrack-v3: see `follower models list`"
