"""What `follower track` was asked for, and the settings that follow from it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from follower.settings import Settings, load_settings
from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box
from follower_vision.fusion import FusionSettings
from follower_vision.fusion.multi import MOST_TARGETS
from follower_vision.fusion.settings import IMPROVEMENTS
from follower_vision.models import MODELS, Purpose
from follower_vision.sources import is_live
from follower_vision.trackers import is_tracker, tracker_names

LIST = "list"
"""What `--select` takes instead of an object, to have them listed."""


@dataclass(frozen=True, slots=True)
class TrackOptions:
    """What the command line was given; see `follower track --help`.

    Raises:
        SettingsError: the options do not say which targets, or contradict each other.
    """

    source: str
    targets: tuple[Box, ...] = ()
    select: tuple[str, ...] = ()
    colour: str | None = None
    tracker: str | None = None
    detector: str | None = None
    appearance: str | None = None
    paper: bool = False
    without: tuple[str, ...] = ()
    realtime: bool = False
    rate_hz: float = 30.0
    save: Path | None = None
    boxes: Path | None = None
    video: bool = True
    record: bool = False
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    out: Path = Path("runs")

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise SettingsError("which source? give a video file, a folder, a camera or a stream")
        self._check_choice()
        if not self.video and self.save is not None:
            raise SettingsError("--save and --no-video contradict each other")
        if self.tracker is not None and not is_tracker(self.tracker):
            names = ", ".join(tracker_names())
            raise SettingsError(f"--tracker {self.tracker}: no such tracker; there are {names}")
        _check_improvements(self.without)

    def _check_choice(self) -> None:
        ways = (self.targets, self.select, self.colour)
        if not any(ways):
            raise SettingsError(
                "which target? give --target x,y,w,h or --select person or --colour '#rrggbb'; "
                "--select list shows what there is"
            )
        if sum(map(bool, ways)) > 1:
            raise SettingsError(
                "choose by one of --target, --select and --colour alone; --select list prints the "
                "boxes of what is seen, which --target takes"
            )
        if self.count > MOST_TARGETS:
            raise SettingsError(f"at most {MOST_TARGETS} targets can be followed, not {self.count}")
        if LIST in self.select and len(self.select) > 1:
            raise SettingsError("--select list stands alone: it lists and follows nothing")

    @property
    def count(self) -> int:
        """How many targets."""
        return max(1, len(self.targets), len(self.select))

    @property
    def in_real_time(self) -> bool:
        """Whether frames come by the clock, and only the newest counts."""
        return self.realtime or is_live(self.source)

    def settings(self) -> Settings:
        """Return the settings: file, then what the options stand for, then each `--set`.

        Choosing by class, `--appearance`, `--paper` and `--without` need a detector: the usual
        one, if none is named.

        Raises:
            SettingsError: a file, key or value cannot be used.
        """
        settings = load_settings(self.config, overrides=(*self._implied(), *self.overrides))
        wanted = self.select or self.paper or self.without or settings.appearance
        if settings.detector is None and wanted:
            return settings.model_copy(update={"detector": usual_detector()})
        return settings

    def _implied(self) -> Iterator[str]:
        if self.paper:
            yield from _changes("fusion", FusionSettings.paper(), FusionSettings())
        yield from (f"fusion.{name}=false" for name in self.without)
        for key in ("tracker", "detector", "appearance"):
            value = getattr(self, key)
            if value is not None:
                yield f"{key}={json.dumps(value)}"


def usual_detector() -> str:
    """Return the name of the detector that is taken where none is named."""
    return next(model.name for model in MODELS if model.usual and model.purpose is Purpose.DETECTOR)


def _check_improvements(names: tuple[str, ...]) -> None:
    for name in names:
        if name not in IMPROVEMENTS:
            raise SettingsError(
                f"--without {name}: no such improvement; there are {', '.join(IMPROVEMENTS)}"
            )


def _changes(prefix: str, settings: Any, usual: Any) -> Iterator[str]:
    """Yield `key=value` for each field in which two settings of one kind differ."""
    for field in dataclasses.fields(settings):
        key = f"{prefix}.{field.name}"
        value, before = getattr(settings, field.name), getattr(usual, field.name)
        if dataclasses.is_dataclass(value):
            yield from _changes(key, value, before)
        elif value != before:
            yield f"{key}={json.dumps(value)}"
