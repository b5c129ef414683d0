"""The fitted model: probabilities, its file, and the one that comes along."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from follower_vision.fusion import model as fitted_model
from follower_vision.fusion.candidates import SECOND, SOURCES
from follower_vision.fusion.features import FEATURES
from follower_vision.fusion.model import THRESHOLDS, CandidateModel, model_for
from follower_vision.trackers.registry import TRACKERS

MOST_NUMBERS = 3050
"""Of four models; one for all trackers but NanoTrack would need 1500."""
FITTED = Path(fitted_model.__file__).parent / "fitted.json"
COUNT = len(FEATURES)
VALUES = st.floats(-1e6, 1e6)


@pytest.fixture(scope="module")
def shipped() -> CandidateModel:
    return model_for("nanotrack-v3")


def stored(model: CandidateModel, path: Path, name: str = "others") -> Path:
    path.write_text(json.dumps({"models": {name: model.to_json()}}), "utf-8")
    return path


def numbers(value: object) -> int:
    if isinstance(value, dict):
        return sum(map(numbers, value.values()))
    if isinstance(value, list):
        return sum(map(numbers, value))
    return isinstance(value, int | float)


@settings(max_examples=40)
@given(features=arrays(float, st.tuples(st.integers(1, 6), st.just(COUNT)), elements=VALUES))
def test_probabilities_lie_between_0_and_1(shipped: CandidateModel, features: np.ndarray) -> None:
    probabilities = shipped.probabilities(features)
    assert probabilities.shape == (len(features), len(THRESHOLDS))
    assert np.all((probabilities >= 0) & (probabilities <= 1))


def test_each_candidate_is_judged_alone(shipped: CandidateModel) -> None:
    features = np.random.default_rng(1).normal(size=(5, COUNT))
    together = shipped.probabilities(features)
    for row, alone in enumerate(features):
        assert shipped.probabilities(alone[None])[0] == pytest.approx(together[row])


def test_a_hand_made_model_answers_by_the_closed_form(judge: CandidateModel) -> None:
    features = np.zeros((1, COUNT))
    features[0, FEATURES.index("support")] = 0.75
    expected = 1 / (1 + np.exp(-8 * np.tanh(4 * 0.75 - 2)))
    assert judge.probabilities(features)[0] == pytest.approx(expected)


def test_stored_and_read_it_is_the_same_to_five_digits(
    shipped: CandidateModel, tmp_path: Path
) -> None:
    again = model_for("any", str(stored(shipped, tmp_path / "mine.json")))
    features = np.random.default_rng(2).normal(size=(20, COUNT))
    assert again.probabilities(features) == pytest.approx(shipped.probabilities(features), abs=1e-3)
    assert again.noise == shipped.noise
    assert again.to_json() == shipped.to_json()


def test_a_model_of_other_features_is_refused(shipped: CandidateModel, tmp_path: Path) -> None:
    other = shipped.to_json()
    other["features"] = [*other["features"][1:], "luck"]
    with pytest.raises(ValueError, match="fitted on other features"):
        CandidateModel.from_json(other)
    path = tmp_path / "other.json"
    path.write_text(json.dumps({"models": {"others": other}}), "utf-8")
    with pytest.raises(ValueError, match=r"other\.json: .*other features: fit it again"):
        model_for("any", str(path))


def test_what_a_model_was_not_fitted_on_has_no_say(shipped: CandidateModel) -> None:
    stored = shipped.to_json()
    older = CandidateModel.from_json(
        {
            **stored,
            "features": stored["features"][:-1],
            "offset": stored["offset"][:-1],
            "factor": stored["factor"][:-1],
            "hidden": [*stored["hidden"][:-2], stored["hidden"][-1]],
        }
    )
    features = np.random.default_rng(4).normal(size=(20, COUNT))
    first = older.probabilities(features)
    features[:, FEATURES.index(stored["features"][-1])] += 5.0
    assert older.probabilities(features) == pytest.approx(first)


@pytest.mark.parametrize("content", [None, "", "[]", "{}", '{"models": {"others": {}}}'])
def test_a_file_that_is_none_is_refused_with_its_name(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "mine.json"
    if content is not None:
        path.write_text(content, "utf-8")
    with pytest.raises(ValueError, match=r"mine\.json: no file of `follower train fusion`"):
        model_for("any", str(path))


def test_a_file_for_another_tracker_says_for_which(shipped: CandidateModel, tmp_path: Path) -> None:
    path = stored(shipped, tmp_path / "mine.json", "nanotrack")
    assert model_for("nanotrack-v1", str(path)).noise == shipped.noise
    with pytest.raises(ValueError, match="fitted for nanotrack, not for correlation"):
        model_for("correlation", str(path))


@pytest.mark.parametrize("name", [*TRACKERS, "mine", "my-own.network"])
def test_there_is_a_model_for_every_tracker(name: str) -> None:
    model = model_for(name)
    assert model.hidden.shape[0] == COUNT + 1
    assert model.output.shape == (model.hidden.shape[1] + 1, len(THRESHOLDS))
    assert np.all(np.isfinite(model.hidden))


def test_where_control_foretells_the_target_a_model_that_has_seen_flights_chooses() -> None:
    usual, foretold = model_for("siamese"), model_for("siamese", foretold=True)
    assert foretold.hidden.shape != usual.hidden.shape
    unused = [usual.factor[FEATURES.index(name)] for name in FEATURES if "deviation" in name]
    assert unused == [0, 0, 0]
    assert all(foretold.factor[FEATURES.index(name)] for name in FEATURES if "deviation" in name)


@pytest.mark.parametrize("name", ["correlation", "nanotrack-v3"])
def test_without_such_a_model_what_control_foretells_is_no_feature(name: str) -> None:
    """How a place fits it counts by itself: see `Target.misplacement`."""
    model = model_for(name)
    assert model_for(name, foretold=True) is model
    assert not any(model.factor[FEATURES.index(one)] for one in FEATURES if "foreseen" in one)


def test_the_models_that_come_along_are_small_and_know_each_source() -> None:
    models = json.loads(FITTED.read_text("utf-8"))["models"]
    assert numbers(models) <= MOST_NUMBERS
    for name, one in models.items():
        sources = set(SOURCES) if name.startswith("siamese") else set(SOURCES) - {SECOND}
        for kind in ("place", "size"):
            assert set(one["noise"][kind]) == sources
            assert all(value > 0 for value in one["noise"][kind].values())
