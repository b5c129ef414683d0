"""Settings of former versions: what their keys have become, and what those are that they lack."""

from collections.abc import Iterator, Mapping
from typing import Any

from follower_control.common.strict_config import SettingsError, merged

_FITTED = "Fusion chooses by a fitted probability; see docs/explanation/fusion.md"
_FUSION_RULES = (
    *("zoomed_validation", "class_lock", "learn_box_ratio", "camera_motion", "score_coasting"),
    *("size_clamp", "distractor_memory", "appearance_check", "growing_search", "keep_template"),
    *("match_iou", "misses_to_lose", "low_ratio", "resume_ratio", "low_frames", "coast_s"),
    *("size_least", "size_most", "position_share", "size_share", "vote_looks", "doubt_ratio"),
    *("doubt_ratio_sure", "insist_s", "doubt_s", "doubt_score", "search_growth_s"),
    *("size_change_found", "reidentify", "blur"),
)
RETIRED = {
    "appearance": "Fusion compares the motion tracker's own features; leave it out",
    "fusion.prospects": "write fusion.target_prediction",
    "fusion.validate_steady_every": "write fusion.validate_every",
    "fusion.validate_blurred_every": "write fusion.doubt_every",
    "fusion.search_every": "write fusion.doubt_every",
    **{f"fusion.{name}": _FITTED for name in _FUSION_RULES},
    "ground_station.definition_uri": "PARAM_* of component 191 offers the settings; leave it out",
}
"""What to do instead of each key, by its path."""
_BEFORE = {"envelope": {"max_yaw_jerk_deg_s3": None}}
"""What was flown before there were these settings: a recording without them means that."""


def refuse_retired(data: Mapping[str, Any], source: str) -> None:
    """Refuse settings that hold a retired key.

    Args:
        data: the settings, sections within sections.
        source: where they were said.

    Raises:
        SettingsError: names the source, the key and what to do instead.
    """
    for key in _paths(data):
        if key in RETIRED:
            raise SettingsError(f"{source}: {key} is gone: {RETIRED[key]}")


def as_recorded(recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a recording, maybe of a former version, as those of this one."""
    return merged(_BEFORE, _without_retired(recorded))


def _without_retired(recorded: Mapping[str, Any], section: str = "") -> dict[str, Any]:
    """Return the settings of a recording without the keys that are retired by now.

    Args:
        recorded: the settings, or one section of them.
        section: the path of that section with its dot, "" for all settings.
    """
    kept = {key: value for key, value in recorded.items() if f"{section}{key}" not in RETIRED}
    return {
        key: _without_retired(value, f"{section}{key}.") if isinstance(value, Mapping) else value
        for key, value in kept.items()
    }


def _paths(data: Mapping[str, Any], section: str = "") -> Iterator[str]:
    for key, value in data.items():
        yield f"{section}{key}"
        if isinstance(value, Mapping):
            yield from _paths(value, f"{section}{key}.")
