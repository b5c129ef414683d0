"""Fusion with a judge and a motion tracker that are no fit: what they believe is written."""

import numpy as np
import pytest
from told_trackers import ToldDetector, ToldMotion, Trackers

from follower_vision.fusion import FusionTracker
from follower_vision.fusion.box_filter import FilterNoise
from follower_vision.fusion.candidates import SOURCES
from follower_vision.fusion.features import FEATURES
from follower_vision.fusion.model import CandidateModel


@pytest.fixture(scope="session")
def noise() -> FilterNoise:
    """The same for every source."""
    return FilterNoise(6.0, 0.2, dict.fromkeys(SOURCES, 0.05), dict.fromkeys(SOURCES, 0.08))


@pytest.fixture(scope="session")
def judge(noise: FilterNoise) -> CandidateModel:
    """Believes what motion tracker or detector is more than half sure of, else the prediction."""
    hidden = np.zeros((len(FEATURES) + 1, 1))
    for name in ("support", "detected_score"):
        hidden[FEATURES.index(name)] = 4.0
    hidden[FEATURES.index("is_prediction")] = 1.5
    hidden[-1] = -2.0
    output = np.array([[8.0, 8.0, 8.0], [0.0, 0.0, 0.0]])
    count = len(FEATURES)
    return CandidateModel(np.zeros(count), np.ones(count), hidden, output, noise)


@pytest.fixture
def motion() -> ToldMotion:
    return ToldMotion()


@pytest.fixture
def fusion(motion: ToldMotion, judge: CandidateModel) -> Trackers:
    """Make a tracker of the told motion tracker, unless other parts are given."""

    def make(detector: ToldDetector | None = None, **parts: object) -> FusionTracker:
        return FusionTracker(motion, detector, **{"model": judge, **parts})  # type: ignore[arg-type]

    return make
