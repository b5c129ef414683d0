"""Numbers held within limits on both sides of zero."""

from __future__ import annotations


def clip(value: float, largest: float) -> float:
    """Return a value, at most `largest` away from zero."""
    return min(max(value, -largest), largest)
