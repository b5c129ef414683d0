"""Runs from several starts: where they begin, figures, and the folds of `fusion_cv.py`."""

import json
import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

from follower.apps.evaluate.contender import AlwaysBelieved
from follower_vision.evaluation.multi_start import Run, sequence_figures
from follower_vision.evaluation.one_pass import Sequence
from follower_vision.geometry.box import Box
from follower_vision.trackers.motion_tracker import IdentityTracker

MULTI_START = Path(__file__).parents[2] / "benchmarks" / "multi_start"
_protocol = runpy.run_path(str(MULTI_START / "__init__.py"))
run_all, starts, pooled_interval = (_protocol[n] for n in ("run_all", "starts", "pooled_interval"))
expected_overlap, calibration_error = _protocol["expected_overlap"], _protocol["calibration_error"]
STILL = Box.from_xywh(20, 20, 20, 20)


def sequence(*truth: Box | None) -> Sequence:
    return Sequence("s", tuple(Path(f"{k}.png") for k in range(len(truth))), truth)


def a_run(overlaps: list[float], confidence: float = 1.0) -> Run:
    flags = tuple(overlap > 0 for overlap in overlaps)
    believed = (True,) * len(overlaps)
    return Run("a", 0, 1, tuple(overlaps), flags, believed, (confidence,) * len(overlaps))


def test_anchors_are_every_100_frames_and_run_towards_the_longer_part() -> None:
    begun = list(starts(sequence(*[STILL] * 400)))
    anchors = [(start.frame, start.step) for start in begun if start.kind == "anchor"]
    assert anchors == [(0, 1), (100, 1), (200, -1), (300, -1)]
    assert sum(start.kind == "jittered" for start in begun) == 3


def test_an_anchor_without_a_target_moves_on_in_its_direction() -> None:
    truth: list[Box | None] = [STILL] * 250
    truth[100:103] = [None] * 3
    truth[198:201] = [None] * 3
    begun = starts(sequence(*truth))
    assert [s.frame for s in begun if s.kind == "anchor"] == [0, 103, 197]


def test_jittered_starts_are_the_same_each_time_and_within_5_percent() -> None:
    first, again = (list(starts(sequence(*[STILL] * 50))) for _ in range(2))
    assert first == again
    for start in first[1:]:
        assert abs(start.box.cx - STILL.cx) <= 0.05 * STILL.width
        assert abs(start.box.width / STILL.width - 1) <= 0.05


def test_a_still_target_is_followed_by_who_stands_still_both_ways(tmp_path: Path) -> None:
    (tmp_path / "s" / "img").mkdir(parents=True)
    for number in range(120):
        name = str(tmp_path / "s" / "img" / f"{number:04}.png")
        cv2.imwrite(name, np.zeros((64, 64, 3), np.uint8))
    (tmp_path / "s" / "groundtruth.txt").write_text("20,20,20,20\n" * 119 + "0,0,0,0\n")
    name, runs = run_all(tmp_path / "s", lambda: AlwaysBelieved(IdentityTracker()))
    assert name == "s"
    assert [(one.frame, one.step, len(one.overlaps)) for one in runs[:2]] == [
        (0, 1, 118),
        (100, -1, 100),
    ]
    assert sequence_figures(runs[:2])["success"] == 1.0


def test_figures_of_a_run() -> None:
    figures = a_run([0.8, 0.6, 0.5, 0.0]).figures
    assert figures["success"] == 0.5
    assert figures["precision"] == 0.75
    assert figures["believed_at_0"] == 0.25


def test_expected_overlap_of_runs_that_end_is_of_those_long_enough() -> None:
    long, short = a_run([0.5] * 300), a_run([1.0] * 40)
    assert expected_overlap([long, short]) == pytest.approx(0.5)
    falls = a_run([1.0] * 50 + [0.0] * 250)
    lengths = np.arange(50, 301, 10)
    assert expected_overlap([falls]) == pytest.approx(np.mean(50 / lengths))


def test_calibration_error_is_how_far_the_confidence_is_from_the_share() -> None:
    assert calibration_error([a_run([0.8] * 10, 0.75)]) == pytest.approx(0.25)
    half = a_run([0.8, 0.0] * 5, 0.5)
    assert calibration_error([half]) == pytest.approx(0.0)


def test_a_pooled_measure_draws_sequences_and_measures_all_their_runs() -> None:
    value, low, high = pooled_interval([[1.0, 1.0], [0.0]], lambda runs: float(np.mean(runs)))
    assert value == pytest.approx(2 / 3)
    assert (low, high) == (0.0, 1.0)


def test_five_folds_of_ten_sequences() -> None:
    folds = json.loads((MULTI_START / "folds.json").read_text("utf-8"))
    assert [sum(fold == k for fold in folds.values()) for k in range(5)] == [10] * 5
