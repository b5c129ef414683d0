"""Settings as a command's options change them."""

import json
from collections.abc import Iterable
from pathlib import Path

from follower.settings.link import check_link
from follower.settings.settings import Settings, load_settings, settings_data
from follower_control.common.strict_config import SettingsError
from follower_vision.models import MODELS, Purpose
from follower_vision.trackers.registry import is_tracker, tracker_names

_LENS_KEYS = ("fov_deg", "focal_px")


def command_settings(
    config: Path | None = None,
    overrides: Iterable[str] | None = None,
    *,
    tracker: str | None = None,
    detector: str | None = None,
    link: str | None = None,
    implied: Iterable[str] = (),
) -> Settings:
    """Return the settings: the file, then what the options stand for, then each `--set`.

    Args:
        config: settings file.
        overrides: `key=value` of each `--set`.
        tracker: of `--tracker`.
        detector: of `--detector`.
        link: of `--link`.
        implied: `key=value` that other options stand for.

    Raises:
        SettingsError: a file, key or value cannot be used.
    """
    if tracker is not None and not is_tracker(tracker):
        names = ", ".join(tracker_names())
        raise SettingsError(f"--tracker {tracker}: no such tracker; there are {names}")
    check_link(link)
    named = {"tracker": tracker, "detector": detector, "link.kind": link}
    given = [f"{key}={json.dumps(value)}" for key, value in named.items() if value is not None]
    return load_settings(config, overrides=(*implied, *given, *(overrides or ())))


USUAL_TRACKER = ("tracker=siamese-correlation", "detector=embedded")
"""What follows a target in a recording where nothing else is named; nothing has to be fetched."""


def implied_tracker(
    config: Path | None, overrides: Iterable[str] | None, *named: str | None
) -> tuple[str, ...]:
    """Return `USUAL_TRACKER`, or nothing where the user names a tracker or a detector.

    Args:
        config: settings file.
        overrides: `key=value` of each `--set`.
        named: what options name.

    Raises:
        SettingsError: a file or an override cannot be read.
    """
    given = settings_data(config, overrides=overrides or ())[0]
    if any(name is not None for name in named) or not {"tracker", "detector"}.isdisjoint(given):
        return ()
    return USUAL_TRACKER


def with_needed_detector(settings: Settings, needed: bool) -> Settings:
    """Return the settings with the usual detector, if one is needed and they name none."""
    if settings.detector is not None or not needed:
        return settings
    return settings.model_copy(update={"detector": usual_detector()})


def usual_detector() -> str:
    """Return the name of the detector that is taken where none is named."""
    return next(model.name for model in MODELS if model.usual and model.purpose is Purpose.DETECTOR)


def lens_is_given(config: Path | None = None, overrides: Iterable[str] | None = None) -> bool:
    """Whether the user's settings describe the lens: the default field of view is nobody's.

    Raises:
        SettingsError: a file or an override cannot be read.
    """
    camera = settings_data(config, overrides=overrides or ())[0].get("camera")
    return isinstance(camera, dict) and any(camera.get(key) is not None for key in _LENS_KEYS)
