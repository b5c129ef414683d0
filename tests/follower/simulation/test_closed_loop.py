"""Linear theory and the simulator agree, in small: azimuth, without pixels.

`benchmarks/closed_loop.py` has all loops, and pixels.
"""

import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from follower.simulation.options import VisionSource
from follower.tuning.tune.run import find_vehicle
from follower_control.tuning.axes import Axis

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


@pytest.fixture(scope="module")
def closed_loop() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield importlib.import_module("closed_loop")


def px4(closed_loop: ModuleType) -> Any:
    return closed_loop.Subject("px4", VisionSource.TRUTH, find_vehicle("px4"))


@pytest.mark.slow
def test_the_azimuth_loop_is_as_fast_as_theory_says(closed_loop: ModuleType) -> None:
    subject = px4(closed_loop)
    settings, here, gains = closed_loop.usual(subject.vehicle)
    predicted, measured = closed_loop.bandwidth(subject, gains, here, settings, Axis.AZIMUTH)
    assert measured == pytest.approx(predicted, rel=0.2)


@pytest.mark.slow
def test_the_azimuth_loop_begins_to_swing_where_theory_says(closed_loop: ModuleType) -> None:
    subject = px4(closed_loop)
    _, _, gains = closed_loop.usual(subject.vehicle)
    at = closed_loop.predicted_onset(subject.vehicle, Axis.AZIMUTH)
    assert not closed_loop.swings(subject, gains, Axis.AZIMUTH, 0.75 * at)
    assert closed_loop.swings(subject, gains, Axis.AZIMUTH, 1.25 * at)
