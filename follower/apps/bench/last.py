"""The last bench of this computer, as a flight asks about it: read without the bench's own parts.

A flight's start is not to wait for pydantic to build the models of `result`.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from follower.settings.recorder import VideoKind
from follower.settings.settings import Settings
from follower_vision.detection.detectors import EMBEDDED
from follower_vision.models import MODELS, Purpose
from follower_vision.onnx_network import AUTO
from follower_vision.user_cache import cache_folder


def last_bench() -> Path:
    """Return where the last bench of this computer is kept, in the user's cache."""
    return cache_folder() / "bench.json"


def more_than_held(
    settings: Settings, size: tuple[int, int], rate_hz: float, path: Path
) -> str | None:
    """Say in one line if a flight asks for more than a bench held.

    None if it does not, if the same tracker, detector and device were not measured on pictures that
    are no larger, or if no bench can be read there.

    Args:
        settings: to fly with.
        size: width and height of the camera's frames, in pixels.
        rate_hz: the camera's.
        path: a bench's JSON file.
    """
    try:
        rows = json.loads(path.read_bytes())["rows"]
        like = [
            row for row in rows if _is_like(row, settings) and _pixels(row) <= size[0] * size[1]
        ]
        best = max(like, key=lambda row: (_pixels(row), row["rate_hz"]), default=None)
        if best is None or best["rate_hz"] >= rate_hz:
            return None
        measured = f"{best['rate_hz']:.0f} frames/s at {best['width']}x{best['height']}"
    except (OSError, ValueError, KeyError, TypeError):
        return None
    names = " and ".join(name for name in (settings.tracker, settings.detector) if name)
    return (
        f"Vision will leave frames out: {names} held {measured} in this computer's last bench, and "
        f"the camera gives {rate_hz:.0f} at {size[0]}x{size[1]}; `follower bench` advises."
    )


def _is_like(row: Mapping[str, Any], settings: Settings) -> bool:
    detector = _own_detector() if settings.detector == EMBEDDED else settings.detector
    fitted = detector is None or settings.fusion.algorithm == "fitted"
    return (
        (row["tracker"], row["detector"]) == (settings.tracker, detector)
        and settings.vision.device in (AUTO, row["device"])
        and row["video"] == (settings.recorder.video is not VideoKind.NONE)
        and row["camera_hz"] is None
        and fitted
    )


def _own_detector() -> str:
    return next(one.name for one in MODELS if one.embedded and one.purpose is Purpose.DETECTOR)


def _pixels(row: Mapping[str, Any]) -> int:
    return int(row["width"] * row["height"])
