"""Where Fusion fails: success and honesty on sequences made harder by a program.

    python benchmarks/fusion_failures.py [DATA] [--only NAME,NAME] [--variants NAME,NAME]
        [--record FOLDER]

DATA holds `sequences` and `weights`, see docs/explanation/fusion.md; without it, patches move over
a generated ground, followed by the correlation tracker without a detector. Each sequence is cut to
150 frames and changed: played backwards, shaken, occluded, joined by look-alikes and so on (see
failures/variants.py). A row a variant, for the motion tracker alone and for Fusion:

- success: share of frames with IoU > 0.5, and precision: with the centre within 20 pixels;
- lies: share of frames called TRACKING at IoU 0, or while the target was out of sight;
- doubts: share of frames with IoU > 0.5 not called TRACKING;
- found: returns of the target, share found within 0.5 s, median time, how many never.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from failures.clip import SYNTHETIC, Clip, read_clip, synthetic_clip
from failures.scoring import Outcome, outcome
from failures.variants import VARIANTS, vary

from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.fusion import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.trackers.motion_tracker import MotionTracker
from follower_vision.trackers.registry import make_tracker
from follower_vision.trackers.track import TrackState

SOON_S = 0.5

Follow = Callable[[Clip], tuple[list[Box], list[bool]]]


def main() -> None:
    """Measure and print a row a variant."""
    cv2.setNumThreads(1)
    options = _options()
    clips = _clips(options)
    motion, fusion = _trackers(options)
    print(f"{'variant':14}{'motion tracker':>16}{'Fusion':>16}   lies  doubts  found")
    rows = []
    for variant in options.variants.split(","):
        alone = _measured(clips, variant, motion, None)
        whole = _measured(clips, variant, fusion, options.record)
        print(_row(variant, alone, whole), flush=True)
        rows.append((alone, whole))
    print(_row("all", *([one for row in rows for one in row[side]] for side in (0, 1))))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path)
    parser.add_argument("--only", default="", help="parts of the sequences' names")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    parser.add_argument("--record", type=Path, help="where each frame's box and state are kept")
    return parser.parse_args()


def _clips(options: argparse.Namespace) -> list[Clip]:
    wanted = options.only.split(",")
    if options.data is not None:
        folders = sorted((options.data / "sequences").iterdir())
        return [read_clip(one) for one in folders if any(part in one.name for part in wanted)]
    return [synthetic_clip(name) for name in SYNTHETIC if any(part in name for part in wanted)]


def _trackers(options: argparse.Namespace) -> tuple[Follow, Follow]:
    if options.data is None:
        motion = make_tracker("correlation", Path)
        return _following(motion), _fusing(FusionTracker(motion))
    weights = options.data / "weights"
    motion = make_tracker("nanotrack-v3", lambda name: weights / name)
    detector = OnnxDetector(weights / "yolox_nano_bi.onnx")
    return _following(motion), _fusing(FusionTracker(motion, detector))


def _following(motion: MotionTracker) -> Follow:
    def follow(clip: Clip) -> tuple[list[Box], list[bool]]:
        motion.start(clip.picture(0), clip.start)
        boxes = [motion.update(clip.picture(number)).box for number in range(1, len(clip))]
        return [clip.start, *boxes], [True] * len(clip)

    return follow


def _fusing(tracker: FusionTracker) -> Follow:
    def follow(clip: Clip) -> tuple[list[Box], list[bool]]:
        tracks = [tracker.start(clip.frame(0), clip.start)]
        tracks += [tracker.step(clip.frame(number)) for number in range(1, len(clip))]
        return [one.box for one in tracks], [one.state is TrackState.TRACKING for one in tracks]

    return follow


def _measured(
    clips: list[Clip], variant: str, follow: Follow, record: Path | None
) -> list[Outcome]:
    answers = []
    for number, clip in enumerate(clips):
        _progress(variant, number, len(clips))
        varied = vary(clip, variant)
        boxes, tracking = follow(varied)
        answers.append(outcome(varied, boxes, tracking))
        if record is not None:
            record.mkdir(parents=True, exist_ok=True)
            rows = np.array([box.xywh for box in boxes])
            np.savez(record / f"{clip.name}@{variant}.npz", boxes=rows, tracking=tracking)
    _progress(variant, len(clips), len(clips))
    return answers


def _progress(variant: str, done: int, total: int) -> None:
    if sys.stderr.isatty():
        end = "\r" if done < total else "\r\033[K"
        print(f"{variant} [{'#' * done}{'.' * (total - done)}]", end=end, file=sys.stderr)


def _row(name: str, alone: list[Outcome], whole: list[Outcome]) -> str:
    pairs = [
        (np.mean([one.success for one in side]), np.mean([one.precision for one in side]))
        for side in (alone, whole)
    ]
    scores = "".join(f"{success:9.3f} /{precision:.3f}" for success, precision in pairs)
    lies = np.mean([one.lies for one in whole])
    doubts = np.mean([one.doubts for one in whole])
    return f"{name:14}{scores}  {lies:5.1%}   {doubts:5.1%}  {_found(whole)}"


def _found(outcomes: list[Outcome]) -> str:
    times = [time for one in outcomes for time in one.found_s]
    if not times:
        return "-"
    soon = np.mean([time <= SOON_S for time in times])
    never = sum(np.isinf(times))
    return f"{len(times)}: {soon:.0%} soon, median {np.median(times):.2f} s, {never} never"


if __name__ == "__main__":
    main()
