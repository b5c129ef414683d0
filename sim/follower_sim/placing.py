"""Random places for scenery, clear of where things move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from follower_sim.scenario import ScatterSettings, SceneryItem
from follower_sim.scenery import SIZES_M
from follower_vision.camera import Vector

_TRIES_PER_ITEM = 40


def scattered(
    settings: ScatterSettings,
    lines: Sequence[Vector],
    standing: Sequence[SceneryItem],
    rng: np.random.Generator,
) -> list[SceneryItem]:
    """Return items at random places near the lines, (N, 3), but clear of them and each other.

    Fewer items than asked for come back where there is no room.
    """
    points = np.vstack(lines)[:, :2]
    low, high = points.min(axis=0) - settings.within_m, points.max(axis=0) + settings.within_m
    sizes = settings.size_m or SIZES_M[settings.kind]
    places = [np.array(item.at) for item in standing]
    items: list[SceneryItem] = []
    for _ in range(settings.count * _TRIES_PER_ITEM):
        if len(items) == settings.count:
            break
        at, size = rng.uniform(low, high), float(rng.uniform(*sizes))
        nearest = float(np.linalg.norm(points - at, axis=1).min())
        if not settings.clear_m <= nearest <= settings.within_m:
            continue
        if any(np.linalg.norm(place - at) < size * 0.8 for place in places):
            continue
        places.append(at)
        heading = float(rng.uniform(0, 360))
        place = (float(at[0]), float(at[1]))
        items.append(SceneryItem(kind=settings.kind, at=place, heading_deg=heading, size_m=size))
    return items
