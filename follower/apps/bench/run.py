"""Runs a bench: what there is to measure, in which order and for how long, and what comes of it."""

import os
import resource
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from follower.apps.bench.advice import MARGIN, Advice, advise, detector_rank, tracker_rank
from follower.apps.bench.last import last_bench
from follower.apps.bench.measure import WARM_S, NotMeasuredError, measure
from follower.apps.bench.report import (
    board_rows,
    compared_rows,
    draw_board,
    draw_compared,
    terminal_table,
)
from follower.apps.bench.result import BenchResult, BenchRow, BenchSetup, read_bench
from follower.apps.bench.scene import BenchClip, Size, render_clips
from follower.apps.preflight.computer_checks import load_per_core
from follower.recording.config import running_processor, running_versions
from follower.recording.run_folder import new_run_folder, remove_run_folder
from follower.settings.recorder import RecorderSettings
from follower.settings.settings import Settings
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import StopOnInterrupt
from follower_control.common.strict_config import SettingsError
from follower_vision.detection.detectors import detector_names, make_detector
from follower_vision.disk import free_bytes, room_said, write_whole
from follower_vision.models import ModelStore, default_folder
from follower_vision.onnx_network import AUTO, CPU, ModelError, accelerators
from follower_vision.plugins import PluginError
from follower_vision.trackers.registry import make_tracker, tracker_names

SIZES: tuple[Size, ...] = ((640, 480), (1280, 720), (1920, 1080))
QUICK_S, USUAL_S = 30.0, 170.0
_SUCCESS, _INTERRUPTED = 0, 130
_PICTURES = 40
_AROUND_S = 1.0
"""What a set-up takes beside the time that is measured: networks are loaded, threads ended."""
_LEAST_S, _MOST_S = 0.6, 4.0
_NO_WORK = "identity"
_NETWORKS = ("re3", "nanotrack-", "siamese")
"""Trackers whose networks onnxruntime runs: those that `vision.device` is for."""
_KB_TO_MB, _BYTES_TO_MB = 1024 / 1e6, 1e-6


@dataclass(frozen=True, slots=True)
class BenchOptions:
    """What is measured.

    Attributes:
        rate_hz: of the camera that the advice is for.
        quick: only Fusion and the trackers that the advice begins with.
        budget_s: the whole bench takes at most about so long.
        sizes: of the frames.
        pictures: of the clip.
        name: of the board; None takes the processor's.
        note: who measured, and what else ran.
        trackers: None takes all whose networks are there.
        detectors: None takes all whose networks are there.
    """

    rate_hz: float = 30.0
    quick: bool = False
    budget_s: float = USUAL_S
    sizes: tuple[Size, ...] = SIZES
    pictures: int = _PICTURES
    name: str | None = None
    note: str = ""
    trackers: tuple[str, ...] | None = None
    detectors: tuple[str, ...] | None = None


def bench(options: BenchOptions, out: Path, console: Console | None = None) -> int:
    """Measure, say and write what came of it; return the exit code.

    Ctrl-C ends it in order: what was measured until then is written.

    Raises:
        SettingsError: nothing could be measured, or not with a video: there is no room.
        OSError: a file cannot be written.
    """
    if (free_bytes(out) or 0) < 1e6 * RecorderSettings().keep_free_mb:
        raise SettingsError(f"--out {room_said(out)}: too little for the videos; name another")
    console = console or Console()
    began_s = time.monotonic()
    cv2.setNumThreads(1)  # as `follower fly` does
    load = load_per_core()
    folder = new_run_folder(out, "bench")
    rows: list[BenchRow] = []
    try:
        with StopOnInterrupt() as asked:
            session = _Session(options, folder, asked, console)
            session.run(began_s, rows)
            if rows:
                _finish(_result(options, rows, session.remarks, load), folder, console)
    finally:
        if not rows:
            remove_run_folder(folder)
    if not rows and not asked.interrupted:
        raise SettingsError(f"nothing could be measured: {'; '.join(session.remarks)}")
    return _INTERRUPTED if asked.interrupted else _SUCCESS


def plan(
    trackers: Sequence[str],
    detectors: Sequence[str],
    devices: Sequence[str],
    sizes: Sequence[Size],
    quick: bool = False,
) -> list[BenchSetup]:
    """Return what is flown, what the advice asks for first.

    Each tracker alone and in Fusion with the best detector, each detector with the best tracker,
    each on the devices that its networks can run on; and the first once more without a video.

    Args:
        trackers: that are there.
        detectors: that are there.
        devices: the processor and what else there is.
        sizes: of the frames.
        quick: the best tracker alone and in Fusion.
    """
    motion, judges = sorted(trackers, key=tracker_rank), sorted(detectors, key=detector_rank)
    pairs: list[tuple[str, str | None]] = [(motion[0], name) for name in judges]
    pairs += [(name, judges[0]) for name in motion[1:] if judges]
    pairs += [(name, None) for name in motion]
    if quick:
        pairs = [pair for pair in pairs if pair[0] == motion[0] and pair[1] in (*judges[:1], None)]
    setups = [
        _setup(pair, device, size) for pair in pairs for device in devices for size in sizes
        if device == CPU or pair[1] is not None or pair[0].startswith(_NETWORKS)
    ]  # fmt: skip
    unrecorded = [_setup(pairs[0], CPU, size, video=False) for size in sizes]
    first = len(sizes) * len(devices)
    return [*setups[:first], *unrecorded, *setups[first:]]


def _setup(pair: tuple[str, str | None], device: str, size: Size, video: bool = True) -> BenchSetup:
    tracker, detector = pair
    width, height = size
    return BenchSetup(
        tracker=tracker, detector=detector, device=device, width=width, height=height, video=video
    )


def _as_flown(advice: Advice) -> BenchSetup:
    """Return what is advised, with a camera of the rate that is."""
    advised = {name: getattr(advice.row, name) for name in BenchSetup.model_fields}
    return BenchSetup(**{**advised, "camera_hz": advice.camera_hz})


class _Session:
    """One bench in front of a user."""

    def __init__(
        self, options: BenchOptions, folder: Path, asked: StopOnInterrupt, console: Console
    ) -> None:
        self._options = options
        self._folder = folder
        self._asked = asked
        self._console = console
        self.remarks: list[str] = []

    def run(self, began_s: float, rows: list[BenchRow]) -> None:
        """Measure what there is time for; `rows` is filled as they come."""
        options = self._options
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
        with Progress(*columns, TimeRemainingColumn(), console=self._console) as bar:
            task = bar.add_task("rendering the flight", total=None)
            clips = render_clips(options.sizes, options.pictures, self._goes_on)
            if clips is None:
                return
            devices = (CPU, *accelerators(AUTO))
            setups = plan(
                self._trackers(), self._detectors(), devices, options.sizes, options.quick
            )
            bar.update(task, total=len(setups) + 1)
            left_s = options.budget_s - (time.monotonic() - began_s)
            around_s = WARM_S + _AROUND_S
            seconds = min(max(left_s / (len(setups) + 1) - around_s, _LEAST_S), _MOST_S)
            until_s = began_s + options.budget_s - 2 * (seconds + around_s)
            for number, setup in enumerate(setups):
                if time.monotonic() > until_s and rows:
                    self.remarks.append(f"{len(setups) - number} set-ups left out: no time")
                    break
                bar.update(task, description=f"{setup.name} {setup.size}")
                if not self._measure(setup, clips[setup.width, setup.height], seconds, rows):
                    return
                bar.advance(task)
            if rows:
                setup = _as_flown(advise(_result(options, rows, (), None)))
                bar.update(task, description=f"{setup.name} {setup.size}, as it flies")
                self._measure(setup, clips[setup.width, setup.height], seconds, rows)
                bar.update(task, completed=len(setups) + 1)

    def _measure(
        self, setup: BenchSetup, clip: BenchClip, seconds: float, rows: list[BenchRow]
    ) -> bool:
        """Measure one set-up; say whether to go on."""
        try:
            row = measure(setup, clip, seconds, self._folder, self._goes_on)
        except NotMeasuredError as error:
            self.remarks.append(str(error))
            return self._goes_on()
        if row is not None:
            rows.append(row)
        return row is not None

    def _goes_on(self) -> bool:
        return not self._asked.interrupted

    def _trackers(self) -> list[str]:
        """Return the trackers that do something and can be made here."""
        store = ModelStore(default_folder())
        names = self._options.trackers or tracker_names()
        wanted = [name for name in names if name != _NO_WORK]
        return self._usable(wanted, lambda name: make_tracker(name, store.file))

    def _detectors(self) -> list[str]:
        """Return the detectors that can be made here."""
        store, named = ModelStore(default_folder()), self._options.detectors
        names = detector_names(store) if named is None else named
        return self._usable(names, lambda name: make_detector(name, store))

    def _usable(self, names: Sequence[str], make: Callable[[str], object]) -> list[str]:
        """Return those that `make` makes, and remark on the others."""
        found, missing = [], []
        for name in names:
            try:
                make(name)
            except PluginError as error:
                self.remarks.append(f"{name} is left out: {error}")
            except ModelError:
                missing.append(name)
            else:
                found.append(name)
        if missing:
            self.remarks.append(f"without {', '.join(missing)}: see `follower models list`")
        return found


def _result(
    options: BenchOptions, rows: Sequence[BenchRow], remarks: Sequence[str], load: float | None
) -> BenchResult:
    processor, cores = running_processor()["model"], len(os.sched_getaffinity(0))
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return BenchResult(
        name=options.name or f"{processor}, {cores} cores",
        note=options.note,
        processor=processor,
        cores=cores,
        memory_mb=round(memory * _BYTES_TO_MB),
        used_mb=round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _KB_TO_MB),
        load=load,
        versions=running_versions(),
        rate_hz=options.rate_hz,
        validate_every=Settings().fusion.validate_every,
        remarks=tuple(remarks),
        rows=tuple(rows),
    )


def _finish(result: BenchResult, folder: Path, console: Console) -> None:
    """Print and write what was measured."""
    advice = advise(result)
    console.print(terminal_table(*board_rows(result)))
    for line in _lines(result, advice):
        print_line(console, line)
    print_line(console, f"\n{advice.to_yaml()}")
    files = [
        write_whole(folder / "bench.json", result.to_json()),
        write_whole(folder / "advised.yaml", advice.to_yaml()),
        draw_board(result, result.rate_hz * (1 + MARGIN), folder / "bench.png"),
    ]
    kept = last_bench()
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, result.to_json())
    except OSError as error:
        print_line(console, f"`follower fly` will not know of it: {kept}: {error.strerror}")
    for file in files:
        print_line(console, f"  {file}")


def _lines(result: BenchResult, advice: Advice) -> list[str]:
    degrees = [row.temperature_c for row in result.rows if row.temperature_c is not None]
    heat = f"{min(degrees):.0f} to {max(degrees):.0f} °C" if degrees else "temperature not told"
    load = "" if result.load is None else f"; load before {result.load:.1f} a core"
    board = f"{result.name}: at most {result.used_mb:.0f} MB of memory, {heat}{load}"
    key = "late: when 99 of 100 control steps have begun; cores: busy; the most over the sizes"
    lost = ["* the target was lost"] if any(row.lost for row in result.rows) else []
    return [key, *lost, board, *result.remarks, "", *advice.lines]


def compare(files: Sequence[Path], out: Path, console: Console | None = None) -> int:
    """Show the figures of several boards side by side, and draw them; return the exit code.

    Raises:
        SettingsError: a file is no bench's, or there are fewer than two.
        OSError: the picture cannot be written.
    """
    if len(files) < 2:
        raise SettingsError("--compare: give two or more files, e.g. --compare a.json b.json")
    results = _told_apart([read_bench(file) for file in files])
    console = console or Console()
    console.print(terminal_table(*compared_rows(results), left=2))
    for result in results:
        note = f" ({result.note})" if result.note else ""
        print_line(console, f"{result.name}{note}: {advise(result).lines[0]}")
    out.mkdir(parents=True, exist_ok=True)
    print_line(console, f"  {draw_compared(results, out / 'compared.png')}")
    return _SUCCESS


def _told_apart(results: Sequence[BenchResult]) -> list[BenchResult]:
    """Number the boards of the same name, as by default those of the same processor are."""
    seen: Counter[str] = Counter()
    named = []
    for result in results:
        seen[result.name] += 1
        number = seen[result.name]
        again = {"name": f"{result.name} ({number})"} if number > 1 else {}
        named.append(result.model_copy(update=again))
    return named
