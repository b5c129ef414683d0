"""The fitted model: from a candidate's features to three probabilities."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from follower_vision.fusion.box_filter import FilterNoise
from follower_vision.fusion.features import FEATURES
from follower_vision.onnx_network import ModelError

Floats = npt.NDArray[np.floating]

FAMILIES = ("nanotrack", "siamese")
"""Motion trackers with a model of their own, by the part of the name before the hyphen."""
OTHERS = "others"
"""The model of all other ones."""
_FORETOLD = "-foretold"
"""Ends the name of the model for targets that control foretells: fitted to both, one model follows
videos worse (success 0.62 instead of 0.71 on every fourth of the open sequences)."""
THRESHOLDS = (0.3, 0.5, 0.7)
"""Overlaps (IoU) whose probabilities the model gives."""


class ProbabilityModel(Protocol):
    """What says how probable candidates are."""

    @property
    def noise(self) -> FilterNoise:
        """Of the filter that goes with it."""
        ...

    def probabilities(self, features: Floats) -> Floats:
        """Return (N, 3), P(IoU > 0.3), P(IoU > 0.5) and P(IoU > 0.7), of (N, F) features."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CandidateModel:
    """P(IoU > 0.3), P(IoU > 0.5) and P(IoU > 0.7) of a candidate, by one hidden layer.

    Attributes:
        offset: (F,) taken off the features.
        factor: (F,) by which they are then multiplied.
        hidden: (F + 1, K) weights of the hidden units (tanh), their biases last.
        output: (K + 1, 3) weights of the logits, their biases last.
        noise: of the filter.
    """

    offset: Floats
    factor: Floats
    hidden: Floats
    output: Floats
    noise: FilterNoise

    def probabilities(self, features: Floats) -> Floats:
        """Return (N, 3) probabilities of N candidates with the features (N, F)."""
        scaled = np.clip((features - self.offset) * self.factor, -6.0, 6.0)
        units = np.tanh(scaled @ self.hidden[:-1] + self.hidden[-1])
        logits = units @ self.output[:-1] + self.output[-1]
        return np.asarray(1.0 / (1.0 + np.exp(-logits)))

    def to_json(self) -> dict[str, Any]:
        """Return what `from_json` takes: features that have a say, numbers of five digits."""
        used = np.flatnonzero(self.factor)
        arrays = {
            "offset": self.offset[used],
            "factor": self.factor[used],
            "hidden": self.hidden[[*used, -1]],
            "output": self.output,
        }
        rounded = {
            name: np.vectorize(lambda v: float(f"{v:.5g}"))(array).tolist()
            for name, array in arrays.items()
        }
        names = [FEATURES[place] for place in used]
        return {"features": names, **rounded, "noise": asdict(self.noise)}

    @classmethod
    def from_json(cls, stored: dict[str, Any]) -> CandidateModel:
        """Make a model from stored numbers.

        Raises:
            ValueError: it was fitted on features that are none of ours.
        """
        known = {name: place for place, name in enumerate(FEATURES)}
        if not set(stored["features"]) <= known.keys():
            raise ValueError("the model was fitted on other features: fit it again")
        # What it was not fitted on has no say: its factor is nothing.
        places = [known[name] for name in stored["features"]]
        fitted = np.array(stored["hidden"])
        offset, factor = np.zeros((2, len(FEATURES)))
        hidden = np.zeros((len(FEATURES) + 1, fitted.shape[1]))
        offset[places], factor[places] = stored["offset"], stored["factor"]
        hidden[places], hidden[-1] = fitted[:-1], fitted[-1]
        return cls(
            offset, factor, hidden, np.array(stored["output"]), FilterNoise(**stored["noise"])
        )


def family_of(motion: str) -> str:
    """Return the name under which a motion tracker's model is kept, by the tracker's name."""
    family = motion.partition("-")[0]
    return family if family in FAMILIES else OTHERS


def model_for(motion: str, path: str | None = None, foretold: bool = False) -> CandidateModel:
    """Return the model that was fitted for a motion tracker.

    Args:
        motion: the tracker's name.
        path: a file of `follower train fusion`; None is the one that comes along.
        foretold: the one for targets that control foretells, if the file has one.

    Raises:
        ModelError: the file cannot be used.
    """
    try:
        models = _models(path)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelError(f"{path}: no file of `follower train fusion` ({error})") from None
    family = family_of(motion)
    if family not in models:
        raise ModelError(f"{path}: fitted for {', '.join(models)}, not for {motion}")
    return models.get(f"{family}{_FORETOLD}", models[family]) if foretold else models[family]


@cache
def _models(path: str | None) -> dict[str, CandidateModel]:
    source = resources.files(__package__) / "fitted.json" if path is None else Path(path)
    stored = json.loads(source.read_text("utf-8"))["models"]
    return {name: CandidateModel.from_json(one) for name, one in stored.items()}
