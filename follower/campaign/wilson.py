"""How sure a share is that was counted."""

from __future__ import annotations

import math

_Z_95 = 1.959963984540054


def wilson(successes: int, count: int, z: float = _Z_95) -> tuple[float, float]:
    """Return the score interval of a share (Wilson, 1927); (0, 1) where nothing was counted.

    Args:
        successes: of them.
        count: of all.
        z: quantile of the normal distribution, by default for 95 %.

    Raises:
        ValueError: there are fewer than none, or more successes than tries.
    """
    if not 0 <= successes <= count:
        raise ValueError(f"{successes} of {count} is no share")
    if count == 0:
        return 0.0, 1.0
    share, z2 = successes / count, z * z
    middle = share + z2 / (2 * count)
    half = z * math.sqrt(share * (1 - share) / count + z2 / (4 * count * count))
    scale = 1 + z2 / count
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)
