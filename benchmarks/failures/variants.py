"""All variants by name."""

from __future__ import annotations

from collections.abc import Callable
from zlib import crc32

import numpy as np

from failures import additions, windows
from failures.clip import Clip

Variant = Callable[[Clip, np.random.Generator], Clip]

VARIANTS: dict[str, Variant] = {
    "plain": windows.shortened,
    "backwards": windows.backwards,
    "skipping": windows.skipping,
    "low_rate": windows.low_rate,
    "half_size": windows.half_size,
    "zoom": windows.zoom,
    "jerk": windows.jerk,
    "looking_away": windows.looking_away,
    "leaving": windows.leaving,
    "occluded": additions.occluded,
    "twin": additions.twin,
    "team": additions.team,
    "merged": additions.merged,
    "blurred": additions.blurred,
    "dim": additions.dim,
}


def vary(clip: Clip, variant: str, seed: int = 0) -> Clip:
    """Return a variant of a clip; the same each time for the same seed."""
    rng = np.random.default_rng([seed, crc32(clip.name.encode()), crc32(variant.encode())])
    return VARIANTS[variant](clip, rng)
