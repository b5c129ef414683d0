"""How far figures over sequences can be trusted: bootstrap intervals, and a paired test.

The sequences are the sample: they are drawn anew (Efron and Tibshirani, "An Introduction to the
Bootstrap", 1993), and two trackers are compared on the same sequences by flipping the signs of
their differences (Fisher's randomisation test). The same input gives the same answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeVar

import numpy as np
import numpy.typing as npt

RESAMPLES, POOLED_RESAMPLES = 10_000, 200
_BOUNDS = (2.5, 97.5)
_ROUNDING = 1e-12

Values = npt.NDArray[np.float64]
Part = TypeVar("Part")


def interval(values: Values, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of a mean over sequences.

    Raises:
        ValueError: there is no value.
    """
    rng = np.random.default_rng(seed)
    drawn = values[rng.integers(0, len(values), (RESAMPLES, len(values)))].mean(axis=1)
    low, high = np.percentile(drawn, _BOUNDS)
    return float(low), float(high)


def pooled_interval(
    by_sequence: Sequence[Sequence[Part]], measure: Callable[[list[Part]], float]
) -> tuple[float, float, float]:
    """Return a measure of all runs together, and its 95 % interval over sequences drawn anew."""
    rng = np.random.default_rng(0)
    values = []
    for _ in range(POOLED_RESAMPLES):
        drawn = rng.integers(0, len(by_sequence), len(by_sequence))
        values.append(measure([one for k in drawn for one in by_sequence[k]]))
    low, high = np.nanpercentile(values, _BOUNDS)
    return measure([one for runs in by_sequence for one in runs]), float(low), float(high)


def paired_p(differences: Values) -> float:
    """Return how often flipped signs give a mean difference at least this far from nothing.

    Of all ways to flip them where these are few, else of `RESAMPLES` drawn ones.
    """
    count = len(differences)
    if 2**count <= RESAMPLES:
        signs = np.array(list(product((1.0, -1.0), repeat=count)))
    else:
        signs = np.random.default_rng(0).choice((-1.0, 1.0), (RESAMPLES, count))
        signs[0] = 1.0  # what was measured is one of the ways
    flipped = np.abs((signs * differences).mean(axis=1))
    return float(np.mean(flipped >= abs(differences.mean()) - _ROUNDING))


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """How much more one tracker has of a figure than another on the same sequences.

    Attributes:
        mean: over the sequences.
        low: lower bound of its 95 % bootstrap interval.
        high: upper bound.
        p: of the paired test: how probable a difference as large is between equal trackers.
    """

    mean: float
    low: float
    high: float
    p: float


def paired_difference(values: Values, others: Values) -> PairedDifference:
    """Compare two trackers by a figure of each on each sequence, in the same order.

    Raises:
        ValueError: the lengths differ, or there is no value.
    """
    differences = values - others
    return PairedDifference(
        float(differences.mean()), *interval(differences), paired_p(differences)
    )
