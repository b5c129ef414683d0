"""How far figures over sequences can be trusted: bootstrap intervals, and a paired test.

The sequences are the sample: they are drawn anew (Efron and Tibshirani, "An Introduction to the
Bootstrap", 1993), and two trackers are compared on the same sequences by flipping the signs of
their differences (Fisher's randomisation test). The same input gives the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

RESAMPLES = 10_000
BOUNDS = (2.5, 97.5)
"""Percentiles of a 95 % interval."""
_ROUNDING = 1e-12

Values = npt.NDArray[np.float64]


def interval(values: Values) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of a mean over sequences.

    Raises:
        ValueError: there is no value.
    """
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(0, len(values), (RESAMPLES, len(values)))].mean(axis=1)
    low, high = np.percentile(drawn, BOUNDS)
    return float(low), float(high)


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
