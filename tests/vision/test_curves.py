"""The curves agree with closed forms and with the reference beside the data."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from follower_vision.evaluation.metrics import (
    ope_curves,
    ope_score,
    spatial_starts,
    temporal_starts,
)
from follower_vision.geometry.box import Box

REFERENCE = Path(__file__).parents[3] / "shared" / "tools" / "ope_reference.py"


def test_a_perfect_track_misses_only_the_threshold_one() -> None:
    curves = ope_curves([Box(9, 9, 4, 6)] * 3, [Box(9, 9, 4, 6)] * 3)
    assert curves.success == (1.0,) * 20 + (0.0,)
    assert curves.normalised_precision == 1.0
    assert curves.precision[0] == 1.0


def test_a_shift_has_its_closed_form() -> None:
    true, shifted = Box(50, 50, 40, 20), Box(60, 50, 40, 20)
    curves = ope_curves([true, shifted], [true, true])
    assert sum(curves.success) == 12  # The overlap is 0.6: thresholds 0 to 0.55 lie below.
    assert (curves.precision[9], curves.precision[10]) == (0.0, 1.0)
    assert curves.normalised_precision == pytest.approx(26 / 51)  # 0.25 of the width


def test_a_missing_box_is_a_miss_at_every_threshold() -> None:
    curves = ope_curves([Box(1, 1, 1, 1), None], [Box(1, 1, 1, 1)] * 2)
    assert max(*curves.success, *curves.precision, *curves.normalised) == 0.0


def test_the_score_agrees_with_the_reference() -> None:
    if not REFERENCE.is_file():
        pytest.skip("no reference scores in ../shared/tools")
    spec = importlib.util.spec_from_file_location("ope_reference", REFERENCE)
    assert spec is not None
    assert spec.loader is not None
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    rng = np.random.default_rng(7)
    truth = [Box(*rng.uniform(20, 60, 4)) for _ in range(300)]
    boxes = [
        b.moved_to(b.cx + rng.normal(0, 12), b.cy + rng.normal(0, 12)).scaled(0.9) for b in truth
    ]
    expected = reference.score([b.xywh for b in boxes], [b.xywh for b in truth])
    score = ope_score(boxes, truth)
    for name in ("success", "precision", "auc"):
        assert getattr(score, name) == pytest.approx(expected[name], abs=1e-9)
    assert np.mean(ope_curves(boxes, truth).success) == pytest.approx(expected["auc"], abs=1e-9)


def test_temporal_starts_have_a_box_and_one_to_score() -> None:
    box = Box(5, 5, 2, 2)
    truth = [box, None, None, None, box, box, None, box]
    assert temporal_starts(truth, 4) == [0, 4]


def test_the_twelve_spatial_starts() -> None:
    starts = spatial_starts(Box(50, 50, 40, 20))
    assert len(set(starts)) == 12
    assert {round(start.cx) for start in starts} == {46, 50, 54}
    assert [round(start.width) for start in starts[8:]] == [32, 36, 44, 48]
